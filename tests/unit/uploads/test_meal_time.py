from datetime import UTC, date, datetime, timedelta, timezone

import pytest

from app.core.errors import ClockDiffersError, InvalidInputError
from app.meals.meal_time import local_minute, meal_time

NOW = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


def code_of(captured_at, zone="Asia/Shanghai"):
    with pytest.raises(InvalidInputError) as caught:
        meal_time(captured_at, zone, NOW)
    return caught.value.code


def test_local_day_is_the_zones_day_not_the_utc_day():
    found = meal_time(datetime.fromisoformat("2026-11-21T00:30:00+08:00"), "Asia/Shanghai", NOW)
    assert found.local_date(0) == date(2026, 11, 21)
    assert found.captured_at.astimezone(UTC).date() == date(2026, 11, 20)
    assert found.utc_offset_minutes == 480


@pytest.mark.parametrize(
    ("instant", "zone", "minute"),
    [
        ("2026-11-20T16:00:00Z", "Asia/Shanghai", 0),
        ("2026-11-20T15:59:59Z", "Asia/Shanghai", 1439),
        ("2026-11-20T06:15:00Z", "Asia/Kathmandu", 720),  # 5 hours 45 minutes ahead
        ("2026-07-01T10:00:00Z", "Europe/Berlin", 720),
        ("2026-12-01T10:00:00Z", "Europe/Berlin", 660),
    ],
)
def test_local_minute_is_that_of_the_clock_on_the_wall(instant, zone, minute):
    assert local_minute(datetime.fromisoformat(instant), zone) == minute


def test_utc_instant_is_accepted_in_any_zone():
    found = meal_time(datetime.fromisoformat("2026-11-20T20:00:00Z"), "Pacific/Auckland", NOW)
    assert found.local_date(0) == date(2026, 11, 21)
    assert found.utc_offset_minutes == 13 * 60


@pytest.mark.parametrize(("offset_hours", "fits"), [(2, True), (1, False)])
def test_offset_must_be_the_one_of_the_zone_on_that_day(offset_hours, fits):
    summer = datetime(2026, 7, 1, 12, 0, tzinfo=timezone(timedelta(hours=offset_hours)))
    if fits:
        assert meal_time(summer, "Europe/Berlin", NOW).utc_offset_minutes == 120
    else:
        assert code_of(summer, "Europe/Berlin") == "offset_not_in_zone"


def test_both_readings_of_the_repeated_hour_are_accepted():
    for offset, minutes in (("+02:00", 120), ("+01:00", 60)):
        found = meal_time(datetime.fromisoformat(f"2026-10-25T02:30:00{offset}"), "Europe/Berlin", NOW)
        assert found.utc_offset_minutes == minutes


def test_naive_time_is_refused():
    assert code_of(datetime(2026, 11, 21, 12, 0)) == "time_without_offset"  # noqa: DTZ001


@pytest.mark.parametrize("zone", ["Mars/Olympus", "../etc/passwd", "", "Asia/Shanghai\x00"])
def test_unknown_zone_is_refused(zone):
    assert code_of(NOW, zone) == "time_zone_unknown"


@pytest.mark.parametrize(
    "instant",
    [
        datetime(1970, 1, 1, tzinfo=UTC),
        datetime(2100, 1, 1, tzinfo=UTC),
        datetime.max.replace(tzinfo=UTC),
        datetime.min.replace(tzinfo=UTC),
    ],
)
def test_impossible_time_is_refused(instant):
    assert code_of(instant) == "time_impossible"


@pytest.mark.parametrize("ahead", [timedelta(days=1, seconds=1), timedelta(days=400), timedelta(days=365 * 26)])
def test_time_that_may_be_right_while_the_servers_clock_is_behind_is_not_refused_for_good(ahead):
    with pytest.raises(ClockDiffersError) as caught:
        meal_time(NOW + ahead, "UTC", NOW)
    assert (caught.value.code, caught.value.retryable, caught.value.status) == ("clock_differs", True, 409)
    assert caught.value.facts["server_time"] == NOW.isoformat(timespec="seconds")


def test_phone_that_is_an_hour_ahead_is_taken():
    assert meal_time(NOW + timedelta(hours=1), "UTC", NOW).local_date(0) == NOW.date()
