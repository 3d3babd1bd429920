from datetime import UTC, date, datetime, timedelta, timezone

import pytest

from app.core.errors import ClockDiffersError, InvalidInputError
from app.meals.stored.meal_time import local_minute, meal_time

NOW = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "zone", "day", "minutes"),
    [
        ("2026-11-21T00:30:00+08:00", "Asia/Shanghai", date(2026, 11, 21), 480),
        ("2026-11-20T20:00:00Z", "Pacific/Auckland", date(2026, 11, 21), 13 * 60),  # UTC is accepted in any zone
        ("2026-07-01T12:00:00+02:00", "Europe/Berlin", date(2026, 7, 1), 120),
        ("2026-10-25T02:30:00+02:00", "Europe/Berlin", date(2026, 10, 25), 120),  # the repeated hour
        ("2026-10-25T02:30:00+01:00", "Europe/Berlin", date(2026, 10, 25), 60),
    ],
)
def test_day_and_offset_are_those_of_the_zone_at_that_time(text, zone, day, minutes):
    found = meal_time(datetime.fromisoformat(text), zone, NOW)
    assert (found.local_date(0), found.utc_offset_minutes) == (day, minutes)


@pytest.mark.parametrize(
    ("captured_at", "zone", "code"),
    [
        (datetime(2026, 7, 1, 12, 0, tzinfo=timezone(timedelta(hours=1))), "Europe/Berlin", "offset_not_in_zone"),
        (datetime(2026, 11, 21, 12, 0), "Asia/Shanghai", "time_without_offset"),  # noqa: DTZ001
        (NOW, "Mars/Olympus", "time_zone_unknown"),
        (NOW, "../etc/passwd", "time_zone_unknown"),
        (NOW, "Asia/Shanghai\x00", "time_zone_unknown"),
        (datetime(1970, 1, 1, tzinfo=UTC), "Asia/Shanghai", "time_impossible"),
        (datetime(2100, 1, 1, tzinfo=UTC), "Asia/Shanghai", "time_impossible"),
        (datetime.min.replace(tzinfo=UTC), "Asia/Shanghai", "time_impossible"),
    ],
)
def test_time_or_zone_that_cannot_be_is_refused(captured_at, zone, code):
    with pytest.raises(InvalidInputError) as caught:
        meal_time(captured_at, zone, NOW)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("instant", "zone", "minute"),
    [
        ("2026-11-20T16:00:00Z", "Asia/Shanghai", 0),
        ("2026-11-20T06:15:00Z", "Asia/Kathmandu", 720),  # 5 hours 45 minutes ahead
        ("2026-12-01T10:00:00Z", "Europe/Berlin", 660),
    ],
)
def test_local_minute_is_that_of_the_clock_on_the_wall(instant, zone, minute):
    assert local_minute(datetime.fromisoformat(instant), zone) == minute


@pytest.mark.parametrize("ahead", [timedelta(days=1, seconds=1), timedelta(days=365 * 26)])
def test_time_that_may_be_right_while_the_servers_clock_is_behind_is_not_refused_for_good(ahead):
    assert meal_time(NOW + timedelta(hours=1), "UTC", NOW).local_date(0) == NOW.date()
    with pytest.raises(ClockDiffersError) as caught:
        meal_time(NOW + ahead, "UTC", NOW)
    assert (caught.value.code, caught.value.retryable, caught.value.status) == ("clock_differs", True, 409)
    assert caught.value.facts["server_time"] == NOW.isoformat(timespec="seconds")
