"""A clock that jumped ahead is believed a day later, one that was set back at once."""

import pytest

from app.operations.clock_jumps import JUMP_SECONDS, WAIT_SECONDS, ClockJumps

YEARS = 10 * 365 * 86400.0
HOUR = 3600.0


@pytest.mark.parametrize(
    "steps",  # jump of the wall clock, then time that passes, both in s; whether the clock is steady after them
    [
        [(0, 0, True), (0, 1, True), (0, HOUR, True), (0, YEARS, True)],
        [(JUMP_SECONDS / 2, HOUR, True)],  # a small correction
        [(YEARS, 1, False), (0, WAIT_SECONDS - 2, False), (0, 2, True)],
        [(YEARS, HOUR, False), (-YEARS, HOUR, True)],  # put right again
        [(YEARS, HOUR, False), (YEARS, WAIT_SECONDS - HOUR, False), (0, HOUR, False), (0, WAIT_SECONDS, True)],
        [(-YEARS, HOUR, True)],  # set back
    ],
)
def test_clock_that_jumped_ahead_is_believed_after_a_day_and_one_that_was_set_back_at_once(steps):
    wall, running = 1.8e9, 500.0
    jumps = ClockJumps(lambda: wall, lambda: running)
    for jump, seconds, is_steady in steps:
        wall += jump + seconds
        running += seconds
        assert jumps.is_steady() is is_steady
