"""The text that asks a sandbox for an answer, and what it is read as."""

import re

import pytest

from app.children.faults import JobFailure
from app.core.errors import InvalidInputError
from app.extras.sandbox.injection import Injection, may_identify, parse_injection
from app.meals.stored.models import Meal
from tests.e2e.processes import REPOSITORY


@pytest.mark.parametrize(
    ("text", "injection"),
    [
        ("status=503 retry_after=3", Injection(status=503, retry_after=3)),
        ("Status=429;Retry-After=0", Injection(status=429, retry_after=0)),
        (" wait=20,lose_answer=0 ", Injection(wait=20, lose_answer=0)),
        ("lose_request=9; meal=no_food_found times=2", Injection(lose_request=9, meal="no_food_found", times=2)),
        ("", Injection()),
    ],
)
def test_parts_are_read_whatever_is_between_them(text, injection):
    assert parse_injection(text) == injection


@pytest.mark.parametrize(
    "text",
    [
        "status=500",
        "wait=61",
        "times=" + "1" * 10,
        "meal=nothing_like_it",
        "slow=3",
        "=3",
    ],
)
def test_other_texts_are_refused_with_the_names_that_there_are(text):
    with pytest.raises(InvalidInputError, match="lose_request") as refusal:
        parse_injection(text)
    assert refusal.value.code == "injection_invalid"


def test_refusals_say_when_to_try_again():
    error = parse_injection("status=429 retry_after=7").error
    assert (error.status, error.code, error.retryable) == (429, "rate_limited", True)
    assert error.facts == {"retry_after_seconds": 7}
    assert parse_injection("wait=1").error is None


def test_every_failure_of_a_meal_can_be_asked_for():
    page = (REPOSITORY / "docs" / "errors.md").read_text()
    section = page.split("## Meals that cannot be measured")[1].split("\n## ")[0]
    codes = set(re.findall(r"^\| `(\w+)`", section, re.MULTILINE)) - {"photograph_erased"}  # no phone is told
    assert len(codes) > 20
    for code in codes:
        assert parse_injection(f"meal={code}").meal == code
        with pytest.raises(JobFailure) as ended:
            may_identify(Meal(details={"wanted_outcome": code}))
        assert ended.value.failure.message
