"""A phone subscribes to reminders, changes when it wants them, and leaves."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, time, timedelta
from zoneinfo import ZoneInfo

from app.core.errors import ConflictError
from app.db.session import Database
from app.extras.reminders import queries
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.models import PushSubscription, Study
from app.people.participants import require_in_study

DAYS_AHEAD = 3  # a time that a change of the clocks skips comes the next day at the latest
# scheduled, but all of the study's times are in the phone's quiet hours
NEVER = datetime(9000, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class ReminderSettings:
    """The columns of a subscription that the phone sends."""

    endpoint: str
    public_key: str
    auth: str
    times: list[str] | None
    after_meal: bool
    time_zone: str
    quiet_from_minutes: int
    quiet_until_minutes: int


@dataclass(frozen=True, slots=True)
class Reminders:
    """subscription: the phone's, or None. study_times: of the protocol."""

    subscription: PushSubscription | None
    study_times: list[str]


def read_reminders(database: Database, caller: DeviceCaller) -> Reminders:
    """Return the phone's subscription and its study's times."""
    with database.read() as session:
        study = session.get_one(Study, caller.study_id)
        return Reminders(
            session.get(PushSubscription, caller.device_id), study.reminder_times or []
        )


def subscribe(
    database: Database, caller: DeviceCaller, wanted: ReminderSettings, *, is_on: bool
) -> Reminders:
    """Subscribe the phone, or change its subscription. Raises ConflictError (`reminders_off`), GoneError."""
    if not is_on:
        raise ConflictError("This server sends no reminders.", code="reminders_off")
    now = datetime.now(UTC)
    with database.write() as session:
        require_in_study(session, caller.participant_id)
        study = session.get_one(Study, caller.study_id)
        queries.lock_device(session, caller.device_id)
        queries.remove_same_browser(session, caller.device_id, wanted.endpoint, wanted.auth)
        row = session.get(PushSubscription, caller.device_id)
        if row is None:
            row = PushSubscription(device_id=caller.device_id, created_at=now)
            session.add(row)
        is_due = row.times == wanted.times and row.next_at is not None and row.next_at <= now
        for column, value in asdict(wanted).items():
            setattr(row, column, value)
        if not is_due:  # else it waits for a worker, who sets the next one too
            row.next_at = next_at(row, study.reminder_times or [], now)
        audit.note(session, caller, "reminders.set", subject=caller.participant_alias)
        session.flush()
        return Reminders(row, study.reminder_times or [])


def unsubscribe(database: Database, caller: DeviceCaller) -> None:
    """Remove the phone's subscription, if it has one."""
    with database.write() as session:
        if queries.remove_subscription(session, caller.device_id):
            audit.note(session, caller, "reminders.delete", subject=caller.participant_alias)


def next_at(row: PushSubscription, study_times: Sequence[str], after: datetime) -> datetime | None:
    """Return when the phone is reminded next; the study's times only outside of its quiet hours.

    Returns NEVER if the study has times but all are quiet; None without times. Raises KeyError, ValueError for a time
    zone that is no longer known.
    """
    zone = ZoneInfo(row.time_zone)
    if row.times is not None:
        return next_due([time.fromisoformat(text) for text in row.times], zone, after)
    times = [at for text in study_times if not is_quiet_for(row, at := time.fromisoformat(text))]
    return next_due(times, zone, after) or (NEVER if study_times else None)


def next_due(times: Iterable[time], zone: ZoneInfo, after: datetime) -> datetime | None:
    """Return the first instant after `after` at which it is one of these local times; None without times.

    A time that does not exist, when clocks go forward, falls as much later; one that comes twice counts once, the
    first time.
    """
    today = after.astimezone(zone).date()
    days = [today + timedelta(days=number) for number in range(-1, DAYS_AHEAD)]
    instants = (
        datetime.combine(day, at, tzinfo=zone).astimezone(UTC) for day in days for at in times
    )
    return min((instant for instant in instants if instant > after), default=None)


def is_quiet(at: time, start: time, end: time) -> bool:
    """Return whether a local time lies within quiet hours, which may pass midnight. Equal times: there are none."""
    return start <= at < end if start <= end else at >= start or at < end


def is_quiet_for(row: PushSubscription, at: time) -> bool:
    """Return whether a local time lies within the phone's quiet hours."""
    return is_quiet(at, clock_time(row.quiet_from_minutes), clock_time(row.quiet_until_minutes))


def clock_time(minutes: int) -> time:
    """Return the time of day so many minutes after midnight."""
    return time(*divmod(minutes, 60))
