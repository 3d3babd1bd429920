"""FHIR's `date` parameter: a prefix and a date or an instant -> bounds of the local day or of the instant.

A date without a time (a year, a month, a day) is of the participant's own calendar, as everywhere in this API: the
meal's local day. A date with a time is an instant and must have an offset; without one it would be ambiguous.
"""

import calendar
import re
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from typing import Literal, TypeVar

from app.core.errors import MalformedRequestError
from app.extras.fhir.queries import IntakeFilter

Prefix = Literal["eq", "ge", "le", "gt", "lt"]
Moment = TypeVar("Moment", date, datetime)

DAY = timedelta(days=1)
DATE = re.compile(r"(\d{4})(?:-(\d{2})(?:-(\d{2}))?)?")
TIME = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}(:\d{2}(\.\d{1,9})?)?(Z|[+-]\d{2}:\d{2})?")
# an intake is an instant: it starts after a period (sa) if it is after it, and ends before one (eb) if it is before it
COMPARED: dict[str, Prefix] = {
    "eq": "eq",
    "ge": "ge",
    "le": "le",
    "gt": "gt",
    "lt": "lt",
    "sa": "gt",
    "eb": "lt",
}
UNSUPPORTED = ("ne", "ap")


def add_date(bounds: IntakeFilter, value: str) -> IntakeFilter:
    """Return the filter with the bounds of one more `date=`. Raises MalformedRequestError."""
    prefix, text = (value[:2], value[2:]) if value[:2].isalpha() else ("eq", value)
    if prefix in UNSUPPORTED:
        raise _bad_date(
            value, f"the prefix {prefix} is not supported; these are: {', '.join(COMPARED)}"
        )
    if prefix not in COMPARED:
        raise _bad_date(value, f"{prefix!r} is no prefix; these are: {', '.join(COMPARED)}")
    try:
        if DATE.fullmatch(text):
            first, last = _ends(COMPARED[prefix], *_days(text), DAY)
            return replace(
                bounds,
                first_day=_latest(bounds.first_day, first),
                last_day=_earliest(bounds.last_day, last),
            )
        if TIME.fullmatch(text):
            since, before = _ends(COMPARED[prefix], *_instants(value, text), timedelta())
            return replace(
                bounds, since=_latest(bounds.since, since), before=_earliest(bounds.before, before)
            )
    except (ValueError, OverflowError):
        raise _bad_date(value, "there is no such date") from None
    raise _bad_date(
        value,
        "write YYYY, YYYY-MM, YYYY-MM-DD or YYYY-MM-DDThh:mm:ss+hh:mm (+ is %2B in an address)",
    )


def _bad_date(value: str, why: str) -> MalformedRequestError:
    return MalformedRequestError(
        f"date={value}: {why}.", code="search_parameter_invalid", parameter="date"
    )


def _ends(
    prefix: Prefix, first: Moment, last: Moment, step: timedelta
) -> tuple[Moment | None, Moment | None]:
    """Return the bounds for a comparison with a period. step: from an end of the period to the first value beyond."""
    match prefix:
        case "eq":
            return first, last
        case "ge":
            return first, None
        case "le":
            return None, last
        case "gt":
            return last + step, None
        case _:
            return None, first - step


def _latest(*moments: Moment | None) -> Moment | None:
    return max((moment for moment in moments if moment is not None), default=None)


def _earliest(*moments: Moment | None) -> Moment | None:
    return min((moment for moment in moments if moment is not None), default=None)


def _days(text: str) -> tuple[date, date]:
    """Return the first and last day of a year, a month or a day."""
    year, month, day = (int(part) for part in [*text.split("-"), "0", "0"][:3])
    if not month:
        return date(year, 1, 1), date(year, 12, 31)
    if not day:
        return date(year, month, 1), date(year, month, calendar.monthrange(year, month)[1])
    return date(year, month, day), date(year, month, day)


def _instants(value: str, text: str) -> tuple[datetime, datetime]:
    """Return (from, before) of a minute, a second or a microsecond."""
    match = TIME.fullmatch(text)
    if match is None or match[3] is None:
        raise _bad_date(
            value, "a time needs an offset, such as Z or +01:00 (+ is %2B in an address)"
        )
    fraction = match[2]
    instant = datetime.fromisoformat(
        text if fraction is None else text.replace(fraction, fraction[:7], 1)
    )
    step = timedelta(minutes=1) if match[1] is None else timedelta(seconds=1)
    instant = instant.astimezone(UTC)
    return instant, instant + (step if fraction is None else timedelta(microseconds=1))
