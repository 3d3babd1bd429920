"""FHIR's `date` parameter: a prefix and a date or an instant -> bounds of the local day, or of the instant.

A date without a time (a year, a month, a day) is of the participant's own calendar, as in all of this API: the meal's
local day. A date with a time is an instant, and must have an offset: without one nobody knows which.
"""

import calendar
import re
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from typing import Literal

from app.core.errors import MalformedRequestError

Prefix = Literal["eq", "ge", "le", "gt", "lt", "sa", "eb"]

DAY = timedelta(days=1)
DATE = re.compile(r"(\d{4})(?:-(\d{2})(?:-(\d{2}))?)?")
TIME = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}(:\d{2}(\.\d{1,9})?)?(Z|[+-]\d{2}:\d{2})?")
# An intake is an instant: it begins after a period when it lies after it (sa), and ends before one when it lies before.
COMPARED: dict[str, Prefix] = {"eq": "eq", "ge": "ge", "le": "le", "gt": "gt", "lt": "lt", "sa": "gt", "eb": "lt"}
UNSUPPORTED = ("ne", "ap")


@dataclass(frozen=True, slots=True)
class DateBounds:
    """first_day and last_day: local days, both included; since <= instant < before. None: no bound."""

    first_day: date | None = None
    last_day: date | None = None
    since: datetime | None = None
    before: datetime | None = None

    def narrowed(self, value: str) -> "DateBounds":
        """These and what one more `date=` asks for. Raises MalformedRequestError (`search_parameter_invalid`)."""
        prefix, text = (value[:2], value[2:]) if value[:2].isalpha() else ("eq", value)
        if prefix in UNSUPPORTED:
            raise bad_date(value, f"the prefix {prefix} is not supported; these are: {', '.join(COMPARED)}")
        if prefix not in COMPARED:
            raise bad_date(value, f"{prefix!r} is no prefix; these are: {', '.join(COMPARED)}")
        try:
            if DATE.fullmatch(text):
                return self._with_days(COMPARED[prefix], *_days(text))
            if TIME.fullmatch(text):
                return self._with_instants(COMPARED[prefix], *_instants(value, text))
        except (ValueError, OverflowError):
            raise bad_date(value, "there is no such date") from None
        raise bad_date(value, "write YYYY, YYYY-MM, YYYY-MM-DD or YYYY-MM-DDThh:mm:ss+hh:mm (+ is %2B in an address)")

    def _with_days(self, prefix: Prefix, first: date, last: date) -> "DateBounds":
        match prefix:
            case "eq":
                return self._within_days(first, last)
            case "ge":
                return self._within_days(first, None)
            case "le":
                return self._within_days(None, last)
            case "gt":
                return self._within_days(last + DAY, None)
            case _:
                return self._within_days(None, first - DAY)

    def _with_instants(self, prefix: Prefix, start: datetime, end: datetime) -> "DateBounds":
        match prefix:
            case "eq":
                return self._between(start, end)
            case "ge":
                return self._between(start, None)
            case "le":
                return self._between(None, end)
            case "gt":
                return self._between(end, None)
            case _:
                return self._between(None, start)

    def _within_days(self, first: date | None, last: date | None) -> "DateBounds":
        firsts = [day for day in (self.first_day, first) if day is not None]
        lasts = [day for day in (self.last_day, last) if day is not None]
        return replace(self, first_day=max(firsts, default=None), last_day=min(lasts, default=None))

    def _between(self, since: datetime | None, before: datetime | None) -> "DateBounds":
        starts = [instant for instant in (self.since, since) if instant is not None]
        ends = [instant for instant in (self.before, before) if instant is not None]
        return replace(self, since=max(starts, default=None), before=min(ends, default=None))


def bad_date(value: str, why: str) -> MalformedRequestError:
    """The error for a `date` that cannot be read."""
    return MalformedRequestError(f"date={value}: {why}.", code="search_parameter_invalid", parameter="date")


def _days(text: str) -> tuple[date, date]:
    """First and last day of a year, a month or a day."""
    year, month, day = (int(part) for part in [*text.split("-"), "0", "0"][:3])
    if not month:
        return date(year, 1, 1), date(year, 12, 31)
    if not day:
        return date(year, month, 1), date(year, month, calendar.monthrange(year, month)[1])
    return date(year, month, day), date(year, month, day)


def _instants(value: str, text: str) -> tuple[datetime, datetime]:
    """From and before: of a minute, of a second, or of the microsecond."""
    found = TIME.fullmatch(text)
    if found is None or found[3] is None:
        raise bad_date(value, "a time needs its offset, such as Z or +01:00 (+ is %2B in an address)")
    fraction = found[2]
    instant = datetime.fromisoformat(text if fraction is None else text.replace(fraction, fraction[:7], 1))
    step = timedelta(minutes=1) if found[1] is None else timedelta(seconds=1)
    instant = instant.astimezone(UTC)
    return instant, instant + (step if fraction is None else timedelta(microseconds=1))
