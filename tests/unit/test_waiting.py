import ctypes
import time

import pytest

from tests.support.waiting import unless_held_up

holding_the_interpreter = ctypes.PyDLL(None)  # whose calls let no other thread of this process run


def test_wrong_answer_after_a_long_wait_is_raised():
    def attempt():
        time.sleep(0.6)  # for the answer: longer than what counts as held up
        raise AssertionError("400 instead of 408")

    with pytest.raises(AssertionError, match="400 instead of 408"):
        unless_held_up(attempt, 0.5)


def test_failure_of_an_attempt_that_was_held_up_does_not_count():
    attempts = []

    def attempt():
        attempts.append(None)
        if len(attempts) == 1:
            holding_the_interpreter.usleep(400_000)
            raise ConnectionResetError
        return "answer"

    assert unless_held_up(attempt, 0.2) == "answer"
    assert len(attempts) == 2


def test_machine_that_holds_up_every_attempt_is_named():
    def attempt():
        holding_the_interpreter.usleep(30_000)
        raise AssertionError("too late")

    with pytest.raises(AssertionError, match="held up every attempt"):
        unless_held_up(attempt, 0.02)
