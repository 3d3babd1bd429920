"""When a meal was: the instant and the zone that the phone tells, checked, and the local day that follows from them."""

from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from zoneinfo import ZoneInfo, available_timezones

from app.errors import InvalidInputError

EARLIEST = datetime(2000, 1, 1, tzinfo=UTC)  # before phones with cameras; a reset clock says 1970
CLOCK_AHEAD = timedelta(hours=24)  # a phone's clock may be ahead by that much and the meal is still taken


@dataclass(frozen=True, slots=True)
class MealTime:
    """captured_at: aware instant; utc_offset_minutes and local_date in time_zone."""

    captured_at: datetime
    utc_offset_minutes: int
    time_zone: str
    local_date: date


def meal_time(captured_at: datetime, time_zone: str, now: datetime) -> MealTime:
    """Check an instant against its zone and the server's clock. Raises InvalidInputError with its code."""
    if captured_at.tzinfo is None:
        raise InvalidInputError(
            "captured_at has no offset: write it like 2026-11-21T12:30:00+08:00.", code="time_without_offset"
        )
    if time_zone not in _zones():
        raise InvalidInputError(
            f"time_zone {time_zone!r} is no IANA time zone: use a name like Asia/Shanghai.", code="time_zone_unknown"
        )
    zone = ZoneInfo(time_zone)
    try:
        local = captured_at.astimezone(zone)
        offset_minutes = round((local.utcoffset() or timedelta()).total_seconds() / 60)
    except OverflowError:
        raise _impossible(captured_at) from None
    if not EARLIEST <= captured_at <= now + CLOCK_AHEAD:
        raise _impossible(captured_at)
    if captured_at.utcoffset() not in (local.utcoffset(), timedelta()):
        raise InvalidInputError(
            f"captured_at has offset {captured_at:%z}, but {time_zone} had {local:%z} then: check the phone's zone.",
            code="offset_not_in_zone",
        )
    return MealTime(captured_at, offset_minutes, time_zone, local.date())


@cache
def _zones() -> frozenset[str]:
    """IANA names; what a machine calls its own time is none."""
    return frozenset(available_timezones() - {"localtime", "Factory", "posixrules"})


def _impossible(captured_at: datetime) -> InvalidInputError:
    return InvalidInputError(
        f"captured_at {captured_at.isoformat()} cannot be: it lies before 2000 or more than a day ahead of the server. "
        "Check the phone's clock.",
        code="time_impossible",
    )
