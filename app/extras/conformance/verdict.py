"""Verdicts of checks on an app or a server."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Verdict:
    """outcome: not_seen, where there was no occasion to show it, is no pass. detail: a sentence, what was seen."""

    outcome: Literal["passed", "failed", "not_seen"]
    detail: str


@dataclass(frozen=True, slots=True)
class Result:
    """A check's verdict. is_required: otherwise it is advice, and a failure of it leaves the whole passed."""

    name: str
    title: str
    verdict: Verdict
    is_required: bool = True


def name_of(check: Callable[..., Verdict]) -> str:
    """Return a check's name in reports."""
    return check.__name__.removeprefix("check_")


def passed(detail: str) -> Verdict:
    """Return a pass."""
    return Verdict("passed", detail)


def failed(detail: str) -> Verdict:
    """Return a failure."""
    return Verdict("failed", detail)


def not_seen(detail: str) -> Verdict:
    """Return the verdict of a check that has had no occasion yet. detail: what would be one."""
    return Verdict("not_seen", detail)


def is_conforming(results: list[Result]) -> bool:
    """Return True if every required check has passed."""
    return all(result.verdict.outcome == "passed" for result in results if result.is_required)
