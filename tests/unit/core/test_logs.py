"""Log lines: facts that those of a request share, ids that are taken over, one traceback a cause and minute."""

import contextvars
import json
import logging
import re
import threading
import uuid

import pytest
import structlog

from app.core.logs import (
    MAX_LINES,
    WINDOW_SECONDS,
    OneTracebackPerCause,
    bind_log_context,
    configure_logging,
    log_context,
    request_id_of,
)
from app.core.settings import Settings


@pytest.fixture
def lines(capsys):
    """What was logged so far, as JSON, by a configuration as the program's own."""
    before = structlog.get_config()
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    configure_logging(Settings())
    yield lambda: [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    structlog.configure(**before)
    root.handlers, root.level = handlers, level


def test_uuid_of_a_phone_or_a_proxy_is_taken_over_without_its_dashes():
    sent = uuid.uuid4()
    assert request_id_of(str(sent)) == request_id_of(sent.hex) == request_id_of(str(sent).upper()) == sent.hex


@pytest.mark.parametrize(
    "sent",
    [
        None,
        "",
        "anna.smith@example.org",
        "0" * 33,
        "61a55825-29ad-4551-a441-e3a9978994ac\n",
        "é" * 32,
    ],
)
def test_anything_but_a_uuid_is_replaced_by_an_id_of_ours(sent):
    given = request_id_of(sent)
    assert re.fullmatch(r"[0-9a-f]{32}", given)
    assert given != sent


def test_facts_stand_in_all_lines_from_then_on_and_in_none_after_the_end(lines):
    log = structlog.get_logger()
    with log_context():
        log.info("before")
        bind_log_context(meal_id="m1")
        thread = threading.Thread(target=lambda: log.info("elsewhere"))
        thread.start()
        thread.join()
        log.info("later", code="c1")
    log.info("outside")
    bind_log_context(meal_id="m2")
    log.info("outside too")
    assert [(line["event"], line.get("meal_id")) for line in lines()] == [
        ("before", None),
        ("elsewhere", None),  # a thread of its own, without this request's context
        ("later", "m1"),
        ("outside", None),
        ("outside too", None),
    ]


def test_fact_told_in_a_thread_of_the_request_stands_in_its_last_line_unless_the_line_says_otherwise(lines):
    log = structlog.get_logger()
    with log_context() as facts:
        context = contextvars.copy_context()  # as anyio.to_thread does
        thread = threading.Thread(target=lambda: context.run(bind_log_context, meal_id="m1"))
        thread.start()
        thread.join()
        log.info("request")
    assert facts == {"meal_id": "m1"}
    assert lines()[0]["meal_id"] == "m1"
    with log_context(meal_id="m1"):
        log.info("other", meal_id="m2")
    assert lines()[0]["meal_id"] == "m2"


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
