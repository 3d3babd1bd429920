"""A meal whole, for the page that shows one: how it stands, and all that came to that, read at one moment."""

import uuid
from dataclasses import dataclass

from app.db.session import Database
from app.meals.job_models import Job
from app.meals.record_models import Recompute, Run
from app.people.access.caller import StaffCaller
from app.people.models import Device
from app.records import story_queries as meal_story
from app.records.read_meal import MealView, find_meal, meal_view
from app.records.review import queries as review
from app.records.review.meal_events import MAX_EVENTS
from app.records.review.meal_history import HistoryRow


@dataclass(frozen=True, slots=True)
class MealStory:
    """view: as `read_meal` has it. The rest the oldest first.

    events: all words of people, those taken back too. runs: of every purpose. jobs: a run has its job's id; one without
    a run waits, or has failed. recomputes: those that touched the meal's foods. device: the phone that sent the meal.
    """

    view: MealView
    events: tuple[HistoryRow, ...]
    runs: tuple[Run, ...]
    jobs: tuple[Job, ...]
    recomputes: tuple[Recompute, ...]
    device: Device | None

    @property
    def last_sequence(self) -> int:
        """Number of the newest event; 0: nobody has said anything."""
        return self.events[-1].event.sequence if self.events else 0


def read_story(
    database: Database, caller: StaffCaller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealStory:
    """The meal with its story. Raises NotFoundError, ConflictError."""
    with database.read() as session:
        meal, participant, study = find_meal(session, caller, client_id, participant_code)
        undone = review.undone_events(session, meal.id)
        return MealStory(
            view=meal_view(session, meal, participant, study),
            events=tuple(
                HistoryRow(event, name or participant, str(event.id) in undone)
                for event, name in review.page_of_events(session, meal.id, after=0, limit=MAX_EVENTS)
            ),
            runs=tuple(meal_story.runs_of(session, meal.id)),
            jobs=tuple(meal_story.jobs_of(session, meal.id)),
            recomputes=tuple(meal_story.recomputes_of(session, meal.id)),
            device=session.get(Device, meal.device_id),
        )
