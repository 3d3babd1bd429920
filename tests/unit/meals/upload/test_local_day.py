"""The study's day of an instant: midnight, day starts, daylight-saving changes, skipped days, travel."""

import os
import subprocess
import sys
from datetime import UTC, date, datetime

import pytest

from app.meals.stored.meal_time import latest_day, local_day

BERLIN, LORD_HOWE, APIA = "Europe/Berlin", "Australia/Lord_Howe", "Pacific/Apia"


@pytest.mark.parametrize(
    ("zone", "starts", "text", "expected"),
    [
        (BERLIN, 240, "2026-11-21T03:59:59+01:00", "2026-11-20"),
        (BERLIN, 240, "2026-11-21T04:00:00+01:00", "2026-11-21"),
        (BERLIN, 0, "2026-11-21T00:00:00+01:00", "2026-11-21"),
        (BERLIN, 0, "2026-11-20T23:59:59+01:00", "2026-11-20"),
        (BERLIN, 150, "2026-03-29T01:59:00+01:00", "2026-03-28"),  # the clock goes from 02:00 to 03:00
        (BERLIN, 150, "2026-03-29T03:00:00+02:00", "2026-03-29"),  # half past two, the day's start, was never shown
        (BERLIN, 150, "2026-10-25T02:29:00+02:00", "2026-10-24"),  # the clock shows 02:00 to 03:00 twice
        (BERLIN, 150, "2026-10-25T02:29:00+01:00", "2026-10-24"),
        (BERLIN, 150, "2026-10-25T02:31:00+01:00", "2026-10-25"),
        (LORD_HOWE, 105, "2026-04-05T01:45:00+11:00", "2026-04-05"),  # 01:30 to 02:00 comes twice
        (LORD_HOWE, 105, "2026-04-05T01:44:00+10:30", "2026-04-04"),
        (APIA, 240, "2011-12-31T01:30:00+14:00", "2011-12-29"),  # the last day that there was: the 30th was skipped
        (APIA, 240, "2011-12-31T04:00:00+14:00", "2011-12-31"),
        ("Pacific/Auckland", 0, "2026-11-20T08:00:00+13:00", "2026-11-20"),  # then nine hours by air over the date line
        ("America/St_Johns", 0, "2010-11-07T02:30:30Z", "2010-11-07"),  # half a minute before it is 23:01 again
        ("America/St_Johns", 0, "2010-11-07T02:31:30Z", "2010-11-06"),
    ],
)
def test_meal_is_of_the_day_that_began_by_the_wall_clock_of_its_place(zone, starts, text, expected):
    assert local_day(datetime.fromisoformat(text), zone, starts).isoformat() == expected


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
        "from app.meals.stored.meal_time import local_day, meal_time\n"
        "now = datetime(2026, 11, 21, tzinfo=UTC)\n"
        "print(meal_time(now, 'Australia/Lord_Howe', now).local_date(0), local_day(now, 'Asia/Kathmandu', 0))\n"
    )
    without = os.environ | {"PYTHONTZPATH": ""}
    done = subprocess.run([sys.executable, "-c", program], env=without, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2026-11-21", "2026-11-21"]
