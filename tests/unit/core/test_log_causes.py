"""One traceback a cause and minute."""

import pytest
import structlog

from app.core.log_causes import MAX_LINES, WINDOW_SECONDS, OneTracebackPerCause


class Clock:
    now = 1000.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def log(clock):
    """log(event, error): the line as it goes out, None if it is left out."""
    processor = OneTracebackPerCause(clock)

    def write(event, error):
        try:
            return processor(None, "error", {"event": event, "exc_info": error})
        except structlog.DropEvent:
            return None

    return write


def raised(kind=ConnectionRefusedError, text="port 5432"):
    try:
        raise kind(text)
    except kind as error:
        return error


def raised_elsewhere():
    try:
        int("no number")
    except ValueError as error:
        return error


def test_hundreds_of_lines_of_one_cause_have_one_traceback(log, clock):
    """While PostgreSQL was away there were 424 tracebacks."""
    lines = [log("request_failed" if n % 2 else "heartbeat_failed", raised(text=f"request {n}")) for n in range(424)]
    written = [line for line in lines if line is not None]
    assert len(written) == MAX_LINES
    assert [("exc_info" in line) for line in written] == [True] + [False] * (MAX_LINES - 1)
    assert {line["cause"] for line in written[1:]} == {"ConnectionRefusedError, logged within the last minute"}
    clock.now += WINDOW_SECONDS + 1
    again = log("request_failed", raised())
    assert "exc_info" in again
    assert again["lines_left_out"] == 424 - MAX_LINES


def test_lines_of_a_mistake_of_ours_or_without_an_exception_are_kept_and_another_cause_has_its_own_traceback(log):
    lines = [log("photo_damaged", raised_elsewhere()) for _ in range(5 * MAX_LINES)]
    assert None not in lines
    assert "exc_info" in log("request_failed", raised())
    for told in (None, False):
        assert log("request", told) == {"event": "request", "exc_info": told}


def test_error_that_was_raised_again_is_of_the_cause_that_it_began_with(log):
    def wrapped():
        try:
            raise raised()
        except ConnectionRefusedError as error:
            try:
                raise RuntimeError("the store is away") from error
            except RuntimeError as outer:
                return outer

    assert "exc_info" in log("a", wrapped())
    assert "exc_info" not in log("b", wrapped())


def test_exception_that_is_handled_now_is_found(log):
    try:
        raise raised()
    except ConnectionRefusedError:
        assert "exc_info" in log("first", True)
        assert "cause" in log("second", True)
