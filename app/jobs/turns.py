"""Whose turn it is: studies that share workers take turns, so that a backlog of one keeps no other waiting.

Start-time fair queueing (Goyal, Vin, Cheng: SIGCOMM 1996) with jobs of equal weight: a job's turn is one more than the
turn of the job before it of its study, but never less than the turn that workers have come to. Workers take the lowest
turn first, the oldest first among equals. So a study that has sent nothing for a while is next, and one that sends
without end is at every other turn beside another that does: nobody starves. Within a study it is first come, first
served.
"""

import threading
import uuid

from sqlalchemy.orm import Session

from app.jobs import queries as jobs
from app.meals.job_models import Job
from app.meals.models import Meal


class Turns:
    """Gives turns; one a process.

    What this process has given is remembered: uploads of a study that are written at the same time do not see each
    other's rows, and would all get the same turn. Several processes may still give a turn once each.
    """

    def __init__(self) -> None:
        self._given: dict[uuid.UUID, int] = {}
        self._lock = threading.Lock()

    def give(self, session: Session, job: Job) -> None:
        """Put the job in its study's line. A job that has a turn keeps it: tried again, it does not go to the back."""
        if job.turn:
            return
        study_id = session.get_one(Meal, job.meal_id).study_id
        now, last = jobs.turns_so_far(session, study_id)
        with self._lock:
            turn = max(now, last + 1, self._given.get(study_id, 0) + 1)
            self._given[study_id] = turn
        job.study_id, job.turn = study_id, turn
