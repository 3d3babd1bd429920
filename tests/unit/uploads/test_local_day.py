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


def calendar_of(zone, first, last):
    """An independent and slow calendar: the dates that the zone's clocks showed, a quarter of an hour at a time."""
    shown, instant = [], first
    while instant <= last:
        shown.append(instant.astimezone(ZoneInfo(zone)).date())
        instant += timedelta(minutes=15)
    return sorted(set(shown))


BERLIN, LORD_HOWE, APIA = "Europe/Berlin", "Australia/Lord_Howe", "Pacific/Apia"


@pytest.mark.parametrize(
    ("zone", "starts", "text", "expected"),
    [
        (BERLIN, 240, "2026-11-21T03:59:59+01:00", "2026-11-20"),
        (BERLIN, 240, "2026-11-21T04:00:00+01:00", "2026-11-21"),
        (BERLIN, 240, "2026-11-20T23:30:00Z", "2026-11-20"),  # 00:30 there
        (BERLIN, 0, "2026-11-21T00:00:00+01:00", "2026-11-21"),
        (BERLIN, 0, "2026-11-20T23:59:59+01:00", "2026-11-20"),
        (BERLIN, 150, "2026-03-29T01:59:00+01:00", "2026-03-28"),  # the clock goes from 02:00 to 03:00
        (BERLIN, 150, "2026-03-29T03:00:00+02:00", "2026-03-29"),  # half past two, the day's start, was never shown
        (BERLIN, 150, "2026-10-25T02:29:00+02:00", "2026-10-24"),  # the clock shows 02:00 to 03:00 twice
        (BERLIN, 150, "2026-10-25T02:31:00+02:00", "2026-10-25"),
        (BERLIN, 150, "2026-10-25T02:29:00+01:00", "2026-10-24"),
        (BERLIN, 150, "2026-10-25T02:31:00+01:00", "2026-10-25"),
        (LORD_HOWE, 105, "2026-04-05T01:45:00+11:00", "2026-04-05"),  # 01:30 to 02:00 comes twice
        (LORD_HOWE, 105, "2026-04-05T01:44:00+10:30", "2026-04-04"),
        (APIA, 240, "2011-12-31T01:30:00+14:00", "2011-12-29"),  # the last day that there was: the 30th was skipped
        (APIA, 240, "2011-12-31T04:00:00+14:00", "2011-12-31"),
        (APIA, 240, "2011-12-29T23:59:00-10:00", "2011-12-29"),
        ("Pacific/Auckland", 0, "2026-11-20T08:00:00+13:00", "2026-11-20"),  # then nine hours by air over the date line
        ("Pacific/Honolulu", 0, "2026-11-20T18:00:00+13:00", "2026-11-19"),
        ("America/St_Johns", 0, "2010-11-07T02:30:30Z", "2010-11-07"),  # half a minute before it is 23:01 again
        ("America/St_Johns", 0, "2010-11-07T02:31:30Z", "2010-11-06"),
    ],
)
def test_meal_is_of_the_day_that_began_by_the_wall_clock_of_its_place(zone, starts, text, expected):
    assert local_day(datetime.fromisoformat(text), zone, starts).isoformat() == expected


@given(instants, zones, day_starts)
def test_day_is_the_clocks_or_the_one_before_it_in_the_zones_calendar(instant, zone, starts):
    local = instant.astimezone(ZoneInfo(zone))
    assert local_day(instant, zone, 0) == local.date()
    found = local_day(instant, zone, starts)
    if local.hour * 60 + local.minute >= starts:
        assert found == local.date()
    else:
        before = calendar_of(zone, instant - timedelta(days=3), instant)
        assert found == [shown for shown in before if shown < local.date()][-1]
    first = local.replace(fold=0)
    assert local_day(first, zone, starts) == local_day(local.replace(fold=1), zone, starts) or _was_skipped(first)


def _was_skipped(local):
    """Whether no clock showed this time: then its two readings are different times."""
    return local.astimezone(UTC).astimezone(local.tzinfo).replace(fold=0, tzinfo=None) != local.replace(tzinfo=None)


@pytest.mark.parametrize("starts", [-1, 1440])
def test_day_start_that_is_no_time_of_day_is_refused(starts):
    with pytest.raises(ValueError, match="0 to 1439"):
        local_day(datetime(2026, 1, 1, tzinfo=UTC), "UTC", starts)


def test_latest_day_is_that_of_the_first_zone_to_begin_it():
    assert latest_day(datetime(2026, 11, 21, 9, 59, tzinfo=UTC)) == date(2026, 11, 21)
    assert latest_day(datetime(2026, 11, 21, 10, 0, tzinfo=UTC)) == date(2026, 11, 22)


@pytest.mark.slow
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
