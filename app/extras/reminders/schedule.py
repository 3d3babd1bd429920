"""Compute when the next reminder is due, from local times of day in the phone's time zone. Pure."""

from collections.abc import Iterable
from datetime import UTC, datetime, time, timedelta
from zoneinfo import ZoneInfo

DAYS_AHEAD = 3  # a time that a change of the clocks skips comes the next day at the latest


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
