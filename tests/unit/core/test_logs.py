"""Facts that all lines of a request share, and which ids of requests are taken over."""

import contextvars
import json
import logging
import re
import threading
import uuid

import pytest
import structlog

from app.core.logs import bind_log_context, configure_logging, log_context, request_id_of
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
        "0" * 31,
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
