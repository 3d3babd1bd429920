"""What the services need of the queue of jobs (jobs/engine.py has the real one)."""

from typing import Protocol

from sqlalchemy.orm import Session

from app.db.models import Job


class JobQueue(Protocol):
    """Where jobs wait."""

    def enqueue(self, session: Session, job: Job) -> None:
        """Write the job down if it is new, and make it run once the session's transaction is committed."""
        ...
