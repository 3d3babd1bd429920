"""The study's day of an instant: midnight, day starts, daylight-saving changes, skipped days, travel."""

import os
import subprocess
import sys
from datetime import UTC, date, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.meals.meal_time import latest_day, local_day

ZONES = (
    "Europe/Berlin",
    "America/St_Johns",  # changed at a minute past midnight until 2011
    "Australia/Lord_Howe",  # half an hour of daylight saving
    "Pacific/Apia",  # had no 30 December 2011
    "Asia/Kathmandu",  # 5 h 45 min
    "America/Sao_Paulo",  # changed at midnight: some days had no 00:00
    "Pacific/Kiritimati",
    "UTC",
)
zones = st.sampled_from(ZONES)
instants = st.datetimes(datetime(2000, 1, 2), datetime(2027, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
day_starts = st.integers(0, 1439)


def day(text, zone, starts=0):
    return local_day(datetime.fromisoformat(text), zone, starts).isoformat()


def calendar_of(zone, first, last):
    """An independent and slow calendar: the dates that the zone's clocks showed, a quarter of an hour at a time."""
    shown, instant = [], first
    while instant <= last:
        shown.append(instant.astimezone(ZoneInfo(zone)).date())
        instant += timedelta(minutes=15)
    return sorted(set(shown))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-11-21T01:30:00+01:00", "2026-11-20"),
        ("2026-11-21T03:59:59+01:00", "2026-11-20"),
        ("2026-11-21T04:00:00+01:00", "2026-11-21"),
        ("2026-11-21T23:59:59+01:00", "2026-11-21"),
        ("2026-11-20T23:30:00Z", "2026-11-20"),  # 00:30 in Berlin
    ],
)
def test_meal_before_the_day_start_belongs_to_the_day_before(text, expected):
    assert day(text, "Europe/Berlin", 240) == expected


def test_with_days_from_midnight_the_day_is_the_calendars():
    assert day("2026-11-21T00:00:00+01:00", "Europe/Berlin") == "2026-11-21"
    assert day("2026-11-20T23:59:59+01:00", "Europe/Berlin") == "2026-11-20"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-03-29T01:59:00+01:00", "2026-03-28"),  # the clock goes from 02:00 to 03:00
        ("2026-03-29T03:00:00+02:00", "2026-03-29"),  # half past two, the day's start, was never shown
        ("2026-10-25T02:29:00+02:00", "2026-10-24"),  # the clock shows 02:00 to 03:00 twice
        ("2026-10-25T02:31:00+02:00", "2026-10-25"),
        ("2026-10-25T02:29:00+01:00", "2026-10-24"),
        ("2026-10-25T02:31:00+01:00", "2026-10-25"),
    ],
)
def test_daylight_saving_changes_go_by_the_wall_clock(text, expected):
    assert day(text, "Europe/Berlin", 150) == expected


def test_half_an_hour_of_daylight_saving():
    assert day("2026-04-05T01:45:00+11:00", "Australia/Lord_Howe", 105) == "2026-04-05"  # 01:30 to 02:00 comes twice
    assert day("2026-04-05T01:44:00+10:30", "Australia/Lord_Howe", 105) == "2026-04-04"


def test_change_at_a_minute_past_midnight_shows_the_evening_before_again():
    first = datetime(
        2010, 11, 7, 2, 30, 30, tzinfo=UTC
    )  # 00:00:30 in St John's, half a minute before it is 23:01 again
    assert local_day(first, "America/St_Johns", 0) == date(2010, 11, 7)
    assert local_day(first + timedelta(minutes=1), "America/St_Johns", 0) == date(2010, 11, 6)


def test_before_the_day_start_after_a_skipped_day_it_is_still_the_last_day_that_there_was():
    assert day("2011-12-31T01:30:00+14:00", "Pacific/Apia", 240) == "2011-12-29"
    assert day("2011-12-31T04:00:00+14:00", "Pacific/Apia", 240) == "2011-12-31"
    assert day("2011-12-29T23:59:00-10:00", "Pacific/Apia", 240) == "2011-12-29"


def test_traveller_has_the_day_of_the_place_where_each_meal_was_eaten():
    breakfast = "2026-11-20T08:00:00+13:00"  # Auckland, then nine hours by air to Honolulu over the date line
    assert day(breakfast, "Pacific/Auckland") == "2026-11-20"
    later = (datetime.fromisoformat(breakfast) + timedelta(hours=10)).isoformat()
    assert day(later, "Pacific/Honolulu") == "2026-11-19"


@given(instants, zones)
def test_day_from_midnight_is_the_date_on_the_wall(instant, zone):
    assert local_day(instant, zone, 0) == instant.astimezone(ZoneInfo(zone)).date()


@given(instants, zones, day_starts)
def test_day_is_the_clocks_or_the_one_before_it_in_the_zones_calendar(instant, zone, starts):
    local = instant.astimezone(ZoneInfo(zone))
    found = local_day(instant, zone, starts)
    if local.hour * 60 + local.minute >= starts:
        assert found == local.date()
    else:
        before = calendar_of(zone, instant - timedelta(days=3), instant)
        assert found == [shown for shown in before if shown < local.date()][-1]


@given(instants, zones, day_starts)
def test_both_readings_of_a_wall_time_are_on_the_same_day(instant, zone, starts):
    local = instant.astimezone(ZoneInfo(zone)).replace(fold=0)
    assert local_day(local, zone, starts) == local_day(local.replace(fold=1), zone, starts) or _was_skipped(local)


def _was_skipped(local):
    """Whether no clock showed this time: then its two readings are different times."""
    return local.astimezone(UTC).astimezone(local.tzinfo).replace(fold=0, tzinfo=None) != local.replace(tzinfo=None)


@given(instants, day_starts)
def test_where_clocks_never_change_it_is_a_shift(instant, starts):
    shifted = instant.astimezone(ZoneInfo("Asia/Kathmandu")) - timedelta(minutes=starts)
    assert local_day(instant, "Asia/Kathmandu", starts) == shifted.date()


@pytest.mark.parametrize("starts", [-1, 1440])
def test_day_start_that_is_no_time_of_day_is_refused(starts):
    with pytest.raises(ValueError, match="0 to 1439"):
        local_day(datetime(2026, 1, 1, tzinfo=UTC), "UTC", starts)


def test_latest_day_is_that_of_the_first_zone_to_begin_it():
    assert latest_day(datetime(2026, 11, 21, 9, 59, tzinfo=UTC)) == date(2026, 11, 21)
    assert latest_day(datetime(2026, 11, 21, 10, 0, tzinfo=UTC)) == date(2026, 11, 22)


def test_zones_are_known_on_a_machine_that_has_none():
    program = (
        "from datetime import UTC, datetime\n"
        "from app.meals.meal_time import local_day, meal_time\n"
        "now = datetime(2026, 11, 21, tzinfo=UTC)\n"
        "print(meal_time(now, 'Australia/Lord_Howe', now).local_date(0), local_day(now, 'Asia/Kathmandu', 0))\n"
    )
    without = os.environ | {"PYTHONTZPATH": ""}
    done = subprocess.run([sys.executable, "-c", program], env=without, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2026-11-21", "2026-11-21"]
