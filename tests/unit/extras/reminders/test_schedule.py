"""The next reminder: local times, over midnight and over changes of the clocks; quiet hours."""

from datetime import UTC, datetime, time
from zoneinfo import ZoneInfo

import pytest

from app.extras.reminders.subscriptions import is_quiet, next_due

BERLIN, AUCKLAND = ZoneInfo("Europe/Berlin"), ZoneInfo("Pacific/Auckland")
NOON, EVENING = time(12), time(18, 30)


def utc(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


@pytest.mark.parametrize(
    ("times", "zone", "after", "due"),
    [
        ([NOON, EVENING], BERLIN, "2026-11-27T10:00", "2026-11-27T11:00"),
        ([NOON, EVENING], BERLIN, "2026-11-27T11:00", "2026-11-27T17:30"),  # not the same one again
        ([NOON, EVENING], BERLIN, "2026-11-27T20:00", "2026-11-28T11:00"),
        ([time(0, 15)], AUCKLAND, "2026-11-27T11:00", "2026-11-27T11:15"),  # there it is the next day
        ([time(2, 30)], BERLIN, "2026-03-28T12:00", "2026-03-29T01:30"),  # does not exist: 03:30
        ([time(2, 30)], BERLIN, "2026-10-25T00:00", "2026-10-25T00:30"),  # comes twice
        ([time(2, 30)], BERLIN, "2026-10-25T00:30", "2026-10-26T01:30"),
    ],
)
def test_next_reminder_is_at_the_local_time(times, zone, after, due):
    assert next_due(times, zone, utc(after)) == utc(due)


@pytest.mark.parametrize(
    ("at", "begin", "end", "quiet"),
    [
        (3, 22, 7, True),
        (22, 22, 7, True),
        (7, 22, 7, False),
        (13, 12, 14, True),
        (14, 12, 14, False),
        (13, 12, 12, False),
    ],
)
def test_quiet_hours_pass_midnight_or_lie_within_a_day(at, begin, end, quiet):
    assert is_quiet(time(at), time(begin), time(end)) is quiet
