"""Read the answer that an app asks a sandbox for: the text of a header, or of a field of a meal's metadata."""

import re
from typing import Literal, Self

from pydantic import ConfigDict, Field, ValidationError, model_validator

from app.children.faults import JobFailure
from app.core.errors import (
    Failure,
    InvalidInputError,
    RateLimitedError,
    TadaError,
    UnavailableError,
)
from app.http.closed_model import ClosedModel
from app.meals.stored.models import Meal
from app.messages.catalogue import photograph_codes, sentence

NEEDS_REVIEW = "needs_review"
MAX_WAIT_SECONDS = 60  # as long as GET /v1/meals/{id} may wait: proxies allow that
MAX_DIGITS = 9
_BETWEEN = re.compile(r"[\s;,]+")


class Injection(ClosedModel):
    """An injected answer.

    wait: seconds before the answer. lose_request: the connection ends after so many bytes of the request's body, of
    which only an upload in pieces keeps what arrived; lose_answer: after so many of the answer's, once the request was
    carried out. meal: the code that its estimate fails with, or needs_review. times: how many requests with this text
    in a meal's metadata are answered so.
    """

    model_config = ConfigDict(frozen=True)

    status: Literal[429, 503] | None = None
    retry_after: int = Field(default=5, ge=0, le=3600)
    wait: int = Field(default=0, ge=0, le=MAX_WAIT_SECONDS)
    lose_request: int | None = Field(default=None, ge=0)
    lose_answer: int | None = Field(default=None, ge=0)
    meal: str | None = None
    times: int = Field(default=1, ge=1, le=100)

    @model_validator(mode="after")
    def _check_meal(self) -> Self:
        if (
            self.meal is not None
            and self.meal != NEEDS_REVIEW
            and self.meal not in photograph_codes()
        ):
            raise ValueError(f"no meal fails with {self.meal!r}")
        return self

    @property
    def error(self) -> TadaError | None:
        """The refusal that is asked for."""
        if self.status is None:
            return None
        kind = RateLimitedError if self.status == RateLimitedError.status else UnavailableError
        return kind(
            "The sandbox was asked for this answer. Nothing was kept.",
            retry_after_seconds=self.retry_after,
        )


def parse_injection(text: str) -> Injection:
    """Read `name=value` parts, separated by blanks, commas or semicolons. Raises InvalidInputError."""
    parts = [part.partition("=") for part in _BETWEEN.split(text.strip()) if part]
    values = {
        name.strip().lower().replace("-", "_"): int(value)
        if value.isdecimal() and len(value) <= MAX_DIGITS
        else value
        for name, _, value in parts
    }
    try:
        return Injection.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InvalidInputError(
            f"The requested answer is invalid: {place + ': ' if place else ''}{first['msg']}. The parts are status, "
            "retry_after, wait, lose_request, lose_answer, meal and times (docs/sandbox.md).",
            code="injection_invalid",
        ) from None


def may_identify(meal: Meal) -> bool:
    """Return whether a meal's foods may be identified. Raises JobFailure for one that is to fail."""
    outcome = meal.details.get("wanted_outcome")
    if outcome is None or outcome == NEEDS_REVIEW:
        return outcome is None
    failure = Failure(
        outcome, sentence(outcome, "en") or "", "The sandbox was asked for this failure."
    )
    raise JobFailure(failure)
