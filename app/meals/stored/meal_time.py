"""A meal's time: check the phone's instant and time zone, and derive the local day.

The day is the study's: it begins at the study's day start, so that a snack at half past one belongs
to the evening before. It follows the wall clock: the same clock time falls on the same day, whether
the hour is the first or the repeated one of a change from daylight-saving time.
"""

from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from functools import cache
from zoneinfo import ZoneInfo, available_timezones

import structlog

from app.core.errors import ClockDiffersError, InvalidInputError

log = structlog.get_logger()

EARLIEST = datetime(2000, 1, 1, tzinfo=UTC)  # before phones with cameras; a reset clock says 1970
# milliseconds read as seconds lie beyond it; merely wrong clocks do not
LATEST = datetime(2100, 1, 1, tzinfo=UTC)
# a meal is accepted from a phone whose clock is ahead by that much
CLOCK_AHEAD = timedelta(hours=24)
CLOCK_RETRY_SECONDS = 600
EASTERNMOST = timedelta(hours=14)  # ahead of UTC: where a day begins first (Kiribati)
NOON = time(12)
CLOCK_DOUBTFUL = "clock_doubtful"
# phones may be offline for a summer; a wrong clock is off by years
LONGEST_OFFLINE = timedelta(days=60)
MOST_AHEAD = timedelta(minutes=15)  # of the server's clock when the meal arrived


@dataclass(frozen=True, slots=True)
class MealTime:
    """captured_at: aware instant; utc_offset_minutes: in time_zone then."""

    captured_at: datetime
    utc_offset_minutes: int
    time_zone: str

    def local_date(self, day_starts_minutes: int) -> date:
        """Return the study's day that the meal belongs to."""
        return local_day(self.captured_at, self.time_zone, day_starts_minutes)


def require_zone(time_zone: str) -> ZoneInfo:
    """Return a time zone by its name. Raises InvalidInputError (`time_zone_unknown`)."""
    if time_zone not in _zones():
        raise InvalidInputError(
            f"time_zone {time_zone!r} is no IANA time zone: use a name like Asia/Shanghai.",
            code="time_zone_unknown",
        )
    return ZoneInfo(time_zone)


def meal_time(captured_at: datetime, time_zone: str, now: datetime) -> MealTime:
    """Check an instant against its zone and the server's clock.

    Raises InvalidInputError with its code.

    An instant more than a day ahead of the server raises ClockDiffersError, so that the phone tries
    again: the server's clock may be the wrong one, and a meal that is refused for good would be
    lost.
    """
    if captured_at.tzinfo is None:
        raise InvalidInputError(
            "captured_at has no offset: write it like 2026-11-21T12:30:00+08:00.",
            code="time_without_offset",
        )
    zone = require_zone(time_zone)
    try:
        local = captured_at.astimezone(zone)
        offset_minutes = round((local.utcoffset() or timedelta()).total_seconds() / 60)
    except OverflowError:
        raise _impossible(captured_at) from None
    if not EARLIEST <= captured_at < LATEST:
        raise _impossible(captured_at)
    if captured_at.utcoffset() not in (local.utcoffset(), timedelta()):
        raise InvalidInputError(
            f"captured_at has offset {captured_at:%z}, but {time_zone} had {local:%z} then: check the phone's zone.",
            code="offset_not_in_zone",
        )
    if captured_at > now + CLOCK_AHEAD:
        log.error("clock_differs", ahead_seconds=round((captured_at - now).total_seconds()))
        raise ClockDiffersError(
            f"captured_at {captured_at.isoformat()} is more than a day ahead of the server's clock. Nothing was kept: "
            "compare server_time with the phone's clock. If the phone's was wrong, correct captured_at; else keep the "
            "meal and try again later.",
            server_time=now.astimezone(UTC).isoformat(timespec="seconds"),
            retry_after_seconds=CLOCK_RETRY_SECONDS,
        )
    return MealTime(captured_at, offset_minutes, time_zone)


def local_day(instant: datetime, time_zone: str, day_starts_minutes: int) -> date:
    """Return the day of an aware instant in a zone, where days begin so many minutes (0 to 1439) after midnight.

    Before that wall-clock time it is the previous day that existed: a zone that crosses the date
    line skips one (Apia went from 29 to 31 December 2011). Raises ValueError for a day start
    outside 0 to 1439.
    """
    if not 0 <= day_starts_minutes < 24 * 60:
        raise ValueError(f"a day starts 0 to 1439 minutes after midnight, not {day_starts_minutes}")
    zone = ZoneInfo(time_zone)
    local = instant.astimezone(zone)
    if local_minute(instant, time_zone) >= day_starts_minutes:
        return local.date()
    day = local.date() - timedelta(days=1)
    while not _is_in_calendar(day, zone):
        day -= timedelta(days=1)
    return day


def local_minute(instant: datetime, time_zone: str) -> int:
    """Return minutes after midnight by the zone's wall clock, 0 to 1439."""
    local = instant.astimezone(ZoneInfo(time_zone))
    return local.hour * 60 + local.minute


def time_flags(origin: str, captured_at: datetime, received_at: datetime) -> list[str]:
    """Flag a meal that arrived long after its time of capture, or before it: the phone's clock may be wrong.

    origin: the meal's; declared meals have no flag.
    """
    is_odd = (
        origin == "photographed" and not -MOST_AHEAD <= received_at - captured_at <= LONGEST_OFFLINE
    )
    return [CLOCK_DOUBTFUL] if is_odd else []


def latest_day(now: datetime) -> date:
    """Return the latest date of any time zone."""
    return (now.astimezone(UTC) + EASTERNMOST).date()


def _is_in_calendar(day: date, zone: ZoneInfo) -> bool:
    """Whether the day existed in the zone: its noon, converted to UTC and back, has the same date."""
    noon = datetime.combine(day, NOON, zone)
    return noon.astimezone(UTC).astimezone(zone).date() == day


@cache
def _zones() -> frozenset[str]:
    """Return IANA names, without a machine's names for its own time."""
    return frozenset(available_timezones() - {"localtime", "Factory", "posixrules"})


def _impossible(captured_at: datetime) -> InvalidInputError:
    return InvalidInputError(
        f"captured_at {captured_at.isoformat()} cannot be: it lies before 2000 or after 2099. Check the phone's clock.",
        code="time_impossible",
    )


def number_of(local_date: date, first_day: date | None) -> int | None:
    """Return the day's number in the study, 1 on the first day; None if the first day is unknown."""
    return None if first_day is None else (local_date - first_day).days + 1
