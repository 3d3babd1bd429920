"""The diary: a participant closes a day, or tells that nothing was eaten; a reviewer's word goes over theirs.

Words are appended, never changed. How a day stands follows from them: the newest word of the highest layer. Means leave
open days out, since a forgotten meal looks like an open day. A meal says more than the word that nothing was eaten:
while there is one, the day stays closed and counts as a day with meals.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Literal

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, PreconditionFailedError
from app.db.session import Database
from app.diary import diary_queries as diary
from app.diary import queries as days
from app.diary.queries import DayRow
from app.http.paging import require_order
from app.http.row_filter import RowFilter
from app.meals.day_models import DayEvent, DiaryDay
from app.meals.event_models import LAYERS
from app.meals.meal_time import EARLIEST, latest_day
from app.outbox.models import Event
from app.outbox.write import announce
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, DeviceCaller, require_study
from app.people.models import Participant
from app.people.participants import has_left
from app.records import queries as records

MAX_RANGE_DAYS = 366
USUAL_RANGE_DAYS = 31

Word = Literal["closed", "ate_nothing", "reopened"]


@dataclass(frozen=True, slots=True)
class Whose:
    """Whose day staff mean; a phone means its own participant's."""

    study_code: str
    participant_code: str


def set_day(
    database: Database,
    caller: Caller,
    local_date: date,
    word: Word,
    *,
    expected: frozenset[int] | None,
    whose: Whose | None = None,
) -> DayRow:
    """Say a word about a day. expected: versions that it is a word over, 0 without any before; None: whatever is there.

    The same word again of the same author, over the version that it was said over, changes nothing.
    Raises InvalidInputError (`day_impossible`), NotFoundError, PreconditionFailedError, ConflictError (`day_has_meals`,
    `participant_withdrawn`), GoneError (`withdrawn`, for the phone).
    """
    now = datetime.now(UTC)
    if not EARLIEST.date() <= local_date <= latest_day(now):
        raise InvalidInputError(f"{local_date} lies before 2000 or in the future.", code="day_impossible")
    with database.write() as session:
        participant = diary.lock_participant(session, find_participant(session, caller, whose).id)
        if participant is None or participant.withdrawn_at is not None:
            if isinstance(caller, DeviceCaller):
                raise has_left()
            raise ConflictError("This participant has left the study.", code="participant_withdrawn")
        events = diary.events_of(session, participant.id, [local_date])
        layer, author = _author(caller)
        if expected is not None and len(events) not in expected:
            if not _is_repeat(events, word, layer, author, expected):
                raise PreconditionFailedError(
                    f"Somebody has said something about {local_date} since: read it again.", version=len(events)
                )
        else:
            meals = diary.count_meals(session, participant.id, local_date) if word == "ate_nothing" else 0
            if meals:
                raise ConflictError(
                    f"There are meals on {local_date}: delete what was not eaten, or close the day.",
                    code="day_has_meals",
                    meals=meals,
                )
            event = DayEvent(
                id=uuid.uuid4(),
                participant_id=participant.id,
                local_date=local_date,
                kind=word,
                layer=layer,
                author=author,
                created_at=_after(events, now),
            )
            session.add(event)
            day = _project(session, participant, local_date, [*events, event])
            if word == "reopened" or day.status == "closed":
                announce_day(session, participant, day)
            note(session, caller, f"day.{word}", study_id=participant.study_id, subject=participant.alias)
    with database.read() as session:  # what is summed over the day takes longer than a writer may
        found = days.find_day(session, participant.id, local_date)
        if found is None:
            raise NotFoundError("There is no such day.")
        return found


def list_days(
    database: Database, caller: Caller, *, first_day: date | None, last_day: date | None, whose: Whose | None = None
) -> list[DayRow]:
    """A participant's days that have a meal or a word, by date; without a range, the last month.

    Raises InvalidInputError for a range that is reversed or longer than MAX_RANGE_DAYS, NotFoundError.
    """
    first, last = day_range(first_day, last_day, latest_day(datetime.now(UTC)), USUAL_RANGE_DAYS)
    with database.read() as session:
        participant = find_participant(session, caller, whose)
        chosen = RowFilter(participant_id=participant.id, first_day=first, last_day=last)
        return days.page_of_days(session, chosen)


def day_range(first_day: date | None, last_day: date | None, latest: date, usual_days: int) -> tuple[date, date]:
    """Complete a range of local days, both included: an end that is not given follows from the other, or from `latest`.

    Raises InvalidInputError (`days_reversed`, `days_too_many`).
    """
    if last_day is None:
        last_day = latest if first_day is None else max(first_day, min(latest, _plus(first_day, MAX_RANGE_DAYS - 1)))
    if first_day is None:
        first_day = _plus(last_day, 1 - usual_days)
    require_order(first_day, last_day)
    if (last_day - first_day).days >= MAX_RANGE_DAYS:
        raise InvalidInputError(
            f"At most {MAX_RANGE_DAYS} days at once.", code="days_too_many", limit_days=MAX_RANGE_DAYS
        )
    return first_day, last_day


def find_participant(session: Session, caller: Caller, whose: Whose | None) -> Participant:
    """The phone's own participant, or the one that staff name. Raises NotFoundError, NotAllowedError."""
    if isinstance(caller, DeviceCaller):
        own = session.get(Participant, caller.participant_id)
        if own is None:  # erased since the token was looked up
            raise has_left()
        return own
    study = people.find_study(session, whose.study_code) if whose is not None else None
    if study is None or whose is None:
        raise NotFoundError("There is no such study.")
    require_study(caller, study.id)
    participant = people.find_participant(session, study.id, whose.participant_code)
    if participant is None:
        raise NotFoundError(f"There is no participant {whose.participant_code!r} in this study.")
    return participant


def project_day(events: Sequence[DayEvent]) -> DayEvent:
    """The word that counts: the newest of the highest layer. events: at least one, the oldest first."""
    highest = max(LAYERS.index(event.layer) for event in events)
    return [event for event in events if LAYERS.index(event.layer) == highest][-1]


def _project(session: Session, participant: Participant, local_date: date, events: Sequence[DayEvent]) -> DiaryDay:
    """Write how the day stands. Its version is the number of words about it."""
    counts = project_day(events)
    change_seq = records.next_change_seq(session, participant.study_id)
    day = session.get(DiaryDay, (participant.id, local_date))
    if day is None:
        day = DiaryDay(participant_id=participant.id, local_date=local_date, study_id=participant.study_id)
        session.add(day)
    day.status = "open" if counts.kind == "reopened" else "closed"
    day.ate_nothing = counts.kind == "ate_nothing"
    day.version = len(events)
    day.changed_at = counts.created_at
    day.change_seq = change_seq
    return day


def _is_repeat(events: Sequence[DayEvent], word: Word, layer: str, author: str, expected: frozenset[int]) -> bool:
    """Whether this was said just before, and the phone did not hear the answer."""
    if not events or len(events) - 1 not in expected:
        return False
    last = events[-1]
    return (last.kind, last.layer, last.author) == (word, layer, author)


def _author(caller: Caller) -> tuple[str, str]:
    """(layer, who says it): of a participant no name, not even their alias in the audit log."""
    if isinstance(caller, DeviceCaller):
        return "participant", "participant"
    return "reviewer", caller.name


def _after(events: Sequence[DayEvent], now: datetime) -> datetime:
    """Now, or just after the last word where the clock was set back meanwhile: their order must stay."""
    return now if not events else max(now, events[-1].created_at + timedelta(microseconds=1))


def _plus(day: date, days: int) -> date:
    return date.fromordinal(min(max(day.toordinal() + days, 1), date.max.toordinal()))


def announce_day(session: Session, participant: Participant, day: DiaryDay) -> None:
    """Something was said about a participant's day: it is closed now, or open again."""
    data = {"participant": participant.code, "local_date": day.local_date.isoformat(), "ate_nothing": day.ate_nothing}
    event: Event = "day.closed" if day.status == "closed" else "day.reopened"
    announce(session, participant.study_id, event, data, participant_id=participant.id)
