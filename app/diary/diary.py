"""The diary: a participant closes a day or enters that nothing was eaten; a reviewer's entry overrides theirs.

Day events are appended, never changed. A day's state is the newest event of the highest layer.
Means leave out open days, since a day with a forgotten meal looks like an open day. A meal
overrides the entry that nothing was eaten: the day stays closed and counts as a day with meals.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, PreconditionFailedError
from app.db.session import Database
from app.diary import queries as days
from app.diary.queries import DayRow
from app.http.paging import require_order
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import LAYERS, DayEvent, DayEventKind, DiaryDay
from app.meals.stored.meal_time import EARLIEST, latest_day
from app.outbox.models import Event
from app.outbox.write import announce
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, DeviceCaller, require_study
from app.people.models import Participant
from app.people.participants import withdrawn_error
from app.records import queries as records

MAX_RANGE_DAYS = 366
DEFAULT_RANGE_DAYS = 31


@dataclass(frozen=True, slots=True)
class ParticipantRef:
    """The participant whose days staff read or change; a phone reads and changes those of its own participant."""

    study_code: str
    participant_code: str


def set_day(
    database: Database,
    caller: Caller,
    local_date: date,
    kind: DayEventKind,
    *,
    expected: frozenset[int] | None,
    participant_ref: ParticipantRef | None = None,
) -> DayRow:
    """Close or reopen a day.

    expected: versions that the caller may have read, 0 without an event; None: any.

    A repeat of the last event, by the same author and with the version before it, changes nothing.
    Raises InvalidInputError (`day_impossible`), NotFoundError, PreconditionFailedError,
    ConflictError (`day_has_meals`, `participant_withdrawn`), GoneError (`withdrawn`, for the
    phone).
    """
    now = datetime.now(UTC)
    if not EARLIEST.date() <= local_date <= latest_day(now):
        raise InvalidInputError(
            f"{local_date} is before 2000 or in the future.", code="day_impossible"
        )
    with database.write() as session:
        participant = days.lock_participant(
            session, find_participant(session, caller, participant_ref).id
        )
        if participant is None or participant.withdrawn_at is not None:
            if isinstance(caller, DeviceCaller):
                raise withdrawn_error()
            raise ConflictError(
                "This participant has left the study.", code="participant_withdrawn"
            )
        events = days.events_of(session, participant.id, [local_date])
        layer, author = _author(caller)
        if expected is not None and len(events) not in expected:
            if not _is_repeat(events, kind, layer, author, expected):
                raise PreconditionFailedError(
                    f"{local_date} was changed after you read it: read it again, then change it.",
                    version=len(events),
                )
        else:
            meals = (
                days.count_meals(session, participant.id, local_date)
                if kind == "ate_nothing"
                else 0
            )
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
                kind=kind,
                layer=layer,
                author=author,
                created_at=_time_after(events, now),
            )
            session.add(event)
            day = _project(session, participant, local_date, [*events, event])
            if kind == "reopened" or day.status == "closed":
                announce_day(session, participant, day)
            note(
                session,
                caller,
                f"day.{kind}",
                study_id=participant.study_id,
                subject=participant.alias,
            )
    with database.read() as session:  # summing the day takes longer than a write transaction should
        row = days.find_day(session, participant.id, local_date)
        if row is None:
            raise NotFoundError("There is no such day.")
        return row


def list_days(
    database: Database,
    caller: Caller,
    *,
    first_day: date | None,
    last_day: date | None,
    participant_ref: ParticipantRef | None = None,
) -> list[DayRow]:
    """Return a participant's days that have a meal or a diary entry, by date; without a range, the last month.

    Raises InvalidInputError for a range that is reversed or longer than MAX_RANGE_DAYS,
    NotFoundError.
    """
    first, last = day_range(first_day, last_day, latest_day(datetime.now(UTC)), DEFAULT_RANGE_DAYS)
    with database.read() as session:
        participant = find_participant(session, caller, participant_ref)
        chosen = RowFilter(participant_id=participant.id, first_day=first, last_day=last)
        return days.page_of_days(session, chosen)


def day_range(
    first_day: date | None, last_day: date | None, latest: date, default_days: int
) -> tuple[date, date]:
    """Complete a range of local days, both included: a missing end follows from the other end, or from `latest`.

    Raises InvalidInputError (`days_reversed`, `days_too_many`).
    """
    if last_day is None:
        last_day = (
            latest
            if first_day is None
            else max(first_day, min(latest, _plus(first_day, MAX_RANGE_DAYS - 1)))
        )
    if first_day is None:
        first_day = _plus(last_day, 1 - default_days)
    require_order(first_day, last_day)
    if (last_day - first_day).days >= MAX_RANGE_DAYS:
        raise InvalidInputError(
            f"At most {MAX_RANGE_DAYS} days at once.",
            code="days_too_many",
            limit_days=MAX_RANGE_DAYS,
        )
    return first_day, last_day


def find_participant(
    session: Session, caller: Caller, participant_ref: ParticipantRef | None
) -> Participant:
    """Return the phone's own participant, or the one that staff refer to.

    Raises NotFoundError, NotAllowedError.
    """
    if isinstance(caller, DeviceCaller):
        own = session.get(Participant, caller.participant_id)
        if own is None:  # erased since the token was looked up
            raise withdrawn_error()
        return own
    study = (
        people.find_study(session, participant_ref.study_code)
        if participant_ref is not None
        else None
    )
    if study is None or participant_ref is None:
        raise NotFoundError("There is no such study.")
    require_study(caller, study.id)
    participant = people.find_participant(session, study.id, participant_ref.participant_code)
    if participant is None:
        raise NotFoundError(
            f"There is no participant {participant_ref.participant_code!r} in this study."
        )
    return participant


def effective_event(events: Sequence[DayEvent]) -> DayEvent:
    """Return the newest event of the highest layer. events: at least one, the oldest first."""
    highest = max(LAYERS.index(event.layer) for event in events)
    return [event for event in events if LAYERS.index(event.layer) == highest][-1]


def _project(
    session: Session, participant: Participant, local_date: date, events: Sequence[DayEvent]
) -> DiaryDay:
    """Write the day's state. Its version is the number of its events."""
    event = effective_event(events)
    change_seq = records.next_change_seq(session, participant.study_id)
    day = session.get(DiaryDay, (participant.id, local_date))
    if day is None:
        day = DiaryDay(
            participant_id=participant.id, local_date=local_date, study_id=participant.study_id
        )
        session.add(day)
    day.status = "open" if event.kind == "reopened" else "closed"
    day.ate_nothing = event.kind == "ate_nothing"
    day.version = len(events)
    day.changed_at = event.created_at
    day.change_seq = change_seq
    return day


def _is_repeat(
    events: Sequence[DayEvent],
    kind: DayEventKind,
    layer: str,
    author: str,
    expected: frozenset[int],
) -> bool:
    """Whether the request repeats the last event, as a phone does that has not received the response."""
    if not events or len(events) - 1 not in expected:
        return False
    last = events[-1]
    return (last.kind, last.layer, last.author) == (kind, layer, author)


def _author(caller: Caller) -> tuple[str, str]:
    """Return (layer, author); a participant is not named, not even by their alias in the audit log."""
    if isinstance(caller, DeviceCaller):
        return "participant", "participant"
    return "reviewer", caller.name


def _time_after(events: Sequence[DayEvent], now: datetime) -> datetime:
    """Return now, or a time just after the last event if the clock was set back, so that events stay in order."""
    return now if not events else max(now, events[-1].created_at + timedelta(microseconds=1))


def _plus(day: date, days: int) -> date:
    return date.fromordinal(min(max(day.toordinal() + days, 1), date.max.toordinal()))


def announce_day(session: Session, participant: Participant, day: DiaryDay) -> None:
    """Announce to webhooks that a participant's day was closed or reopened."""
    data = {
        "participant": participant.code,
        "local_date": day.local_date.isoformat(),
        "ate_nothing": day.ate_nothing,
    }
    event: Event = "day.closed" if day.status == "closed" else "day.reopened"
    announce(session, participant.study_id, event, data, participant_id=participant.id)
