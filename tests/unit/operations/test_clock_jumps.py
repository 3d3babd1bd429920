"""A clock that jumped ahead is believed a day later, one that was set back at once."""

from app.operations.clock_jumps import JUMP_SECONDS, WAIT_SECONDS, ClockJumps

YEARS = 10 * 365 * 86400.0
HOUR = 3600.0


class Clocks:
    def __init__(self):
        self.wall, self.running = 1.8e9, 500.0
        self.jumps = ClockJumps(lambda: self.wall, lambda: self.running)

    def pass_by(self, seconds):
        self.wall += seconds
        self.running += seconds
        return self.jumps.is_steady()


def test_clock_that_goes_on_is_steady_however_long():
    clocks = Clocks()
    assert all(clocks.pass_by(seconds) for seconds in (0, 1, HOUR, YEARS))


def test_small_correction_is_no_jump():
    clocks = Clocks()
    clocks.wall += JUMP_SECONDS / 2
    assert clocks.pass_by(HOUR)


def test_clock_that_jumped_ahead_is_believed_after_a_day():
    clocks = Clocks()
    clocks.wall += YEARS
    assert not clocks.pass_by(1)
    assert not clocks.pass_by(WAIT_SECONDS - 2)
    assert clocks.pass_by(2)


def test_clock_that_is_put_right_again_is_believed_at_once():
    clocks = Clocks()
    clocks.wall += YEARS
    assert not clocks.pass_by(HOUR)
    clocks.wall -= YEARS
    assert clocks.pass_by(HOUR)


def test_second_jump_ahead_begins_the_wait_anew():
    clocks = Clocks()
    clocks.wall += YEARS
    assert not clocks.pass_by(HOUR)
    clocks.wall += YEARS
    assert not clocks.pass_by(WAIT_SECONDS - HOUR)
    assert not clocks.pass_by(HOUR)
    assert clocks.pass_by(WAIT_SECONDS)


def test_clock_that_was_set_back_is_believed():
    clocks = Clocks()
    clocks.wall -= YEARS
    assert clocks.pass_by(HOUR)
