"""What the services need of the queue of jobs (jobs/engine.py has the real one)."""

import uuid
from typing import Protocol

from sqlalchemy.orm import Session


class JobQueue(Protocol):
    """Where jobs wait."""

    def enqueue(self, session: Session, job_id: uuid.UUID) -> None:
        """Make the job run once the session's transaction is committed."""
        ...
