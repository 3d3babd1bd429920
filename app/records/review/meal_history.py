"""A meal's history: pages of its events, and all of it for the page of one meal.

Staff see the authors' names; a participant sees only `participant` or `reviewer`.
"""

import uuid
from dataclasses import dataclass

from app.db.session import Database
from app.http.paging import WHOLE_NUMBER, Page, decode_cursor, encode_cursor
from app.meals.stored.event_models import MealEvent
from app.meals.stored.job_models import Job
from app.meals.stored.record_models import Recompute, Run
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.models import Device
from app.records import queries as records
from app.records.read_meal import MealView, find_meal, meal_view
from app.records.review import queries as review
from app.records.review.meal_events import MAX_EVENTS


@dataclass(frozen=True, slots=True)
class HistoryRow:
    """An event, its author as far as the caller may see, and whether it was undone."""

    event: MealEvent
    author: str
    is_undone: bool


def read_history(
    database: Database,
    caller: Caller,
    client_id: uuid.UUID,
    participant_code: str | None,
    *,
    cursor: str | None,
    limit: int,
) -> Page[HistoryRow]:
    """Return a page of the meal's events, oldest first.

    Raises NotFoundError, ConflictError, InvalidInputError.
    """
    with database.read() as session:
        meal, code, _ = find_meal(session, caller, client_id, participant_code)
        listed = f"events/{meal.id}"
        after = decode_cursor(listed, cursor, WHOLE_NUMBER)
        events = review.page_of_events(session, meal.id, after=after or 0, limit=limit + 1)
        undone = review.undone_events(session, meal.id)
    rows = [
        HistoryRow(
            event,
            event.layer if isinstance(caller, DeviceCaller) else name or code,
            str(event.id) in undone,
        )
        for event, name in events[:limit]
    ]
    is_last = len(events) <= limit
    return Page(rows, None if is_last else encode_cursor(listed, rows[-1].event.sequence))


@dataclass(frozen=True, slots=True)
class MealStory:
    """view: as returned by `read_meal`. All lists start with the oldest.

    events: including undone ones
    runs: of every purpose
    jobs: a run has its job's id; a job without a run is waiting or has failed
    recomputes: those that changed the meal's foods
    device: the phone that sent the meal
    """

    view: MealView
    events: tuple[HistoryRow, ...]
    runs: tuple[Run, ...]
    jobs: tuple[Job, ...]
    recomputes: tuple[Recompute, ...]
    device: Device | None

    @property
    def last_sequence(self) -> int:
        """Sequence number of the newest event; 0: there is none."""
        return self.events[-1].event.sequence if self.events else 0


def read_story(
    database: Database,
    caller: StaffCaller,
    client_id: uuid.UUID,
    participant_code: str | None = None,
) -> MealStory:
    """Read the meal with its history. Raises NotFoundError, ConflictError."""
    with database.read() as session:
        meal, participant, study = find_meal(session, caller, client_id, participant_code)
        undone = review.undone_events(session, meal.id)
        return MealStory(
            view=meal_view(session, meal, participant, study),
            events=tuple(
                HistoryRow(event, name or participant, str(event.id) in undone)
                for event, name in review.page_of_events(
                    session, meal.id, after=0, limit=MAX_EVENTS
                )
            ),
            runs=tuple(records.runs_of(session, meal.id)),
            jobs=tuple(records.jobs_of(session, meal.id)),
            recomputes=tuple(records.recomputes_of(session, meal.id)),
            device=session.get(Device, meal.device_id),
        )
