"""End the windows of after-meal pairs: the meals' records are then final, unless a pair arrives later.

A chore of every worker (jobs/chores.py). Concurrent runs do no harm: a meal is locked and checked again.
"""

import uuid
from datetime import UTC, datetime

from app.db.session import Database
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal
from app.records.project_records import project_meal

BATCH = 100


class AfterWindows:
    """The chore of one process."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def close_due(self) -> int:
        """End at most BATCH windows that are over, each in its own transaction. Returns their number.

        A pair that is queued or being measured ends its window itself.
        """
        now, closed = datetime.now(UTC), 0
        with self._database.read() as session:
            due = meals.after_windows_over(session, now, BATCH)
        for meal_id in due:
            closed += self._close(meal_id, now)
        return closed

    def _close(self, meal_id: uuid.UUID, now: datetime) -> bool:
        with self._database.write() as session:
            meal = meals.lock_meal(session, meal_id)
            if meal is None or not _is_over(meal, now):
                return False
            meal.after_due_at = None
            project_meal(session, meal)
        return True


def _is_over(meal: Meal, now: datetime) -> bool:
    return (
        meal.after_due_at is not None
        and meal.after_due_at <= now
        and meal.after_status not in meals.WAITING
    )
