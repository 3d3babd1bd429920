"""The query of GET /fhir/NutritionIntake -> a search, and the parameters that were used for it.

An unsupported parameter is ignored and reported, or refused with `Prefer: handling=strict`. A value that cannot be read
is always refused: without its filter the result would be wrong.
"""

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from app.core.errors import MalformedRequestError
from app.extras.fhir.dates import add_date
from app.extras.fhir.fhir_intakes import IntakeSearch, PersonName
from app.extras.fhir.names import EVENT_STATUS, Names, person_of_id, person_of_token
from app.extras.fhir.queries import IntakeFilter

DEFAULT_COUNT, MOST_COUNT = 50, 100
MOST_VALUES = 50  # of one parameter, separated by commas
CURSOR = "_cursor"
STATUSES = (
    "preparation", "in-progress", "not-done", "on-hold", "stopped", "completed", "entered-in-error", "unknown",
)  # fmt: skip
PROVISIONAL = {"in-progress": True, "completed": False}
FORMAT_PARAMETERS = frozenset({"_format", "_pretty"})  # do not affect the search
NOBODY = PersonName("", "")  # matches no participant


@dataclass(frozen=True, slots=True)
class SearchQuery:
    """used: the parameters that were used, as they were sent. ignored: names of the others."""

    search: IntakeSearch
    count: int
    cursor: str | None
    used: tuple[tuple[str, str], ...]
    ignored: tuple[str, ...]


@dataclass(slots=True)
class _Reading:
    names: Names
    people: list[tuple[PersonName, ...]] = field(default_factory=list)
    chosen: IntakeFilter = field(default_factory=IntakeFilter)
    provisional: set[bool] = field(default_factory=lambda: {True, False})
    count: int = DEFAULT_COUNT
    cursor: str | None = None


def read_search(
    parameters: Iterable[tuple[str, str]], names: Names, *, is_strict: bool
) -> SearchQuery:
    """Read the query.

    Raises MalformedRequestError: `search_parameter_invalid`, and if is_strict `search_parameter_unsupported`.
    """
    reading, used, ignored = _Reading(names), [], []
    for name, value in parameters:
        if name in FORMAT_PARAMETERS:
            continue
        if not _is_supported(name, value):
            ignored.append(name)
            continue
        if not value:
            raise _invalid(name, "has no value")
        READERS[name](reading, name, value)
        if name != CURSOR:
            used.append((name, value))
    if ignored and is_strict:
        raise MalformedRequestError(
            f"Not supported here: {', '.join(dict.fromkeys(ignored))}. GET /fhir/metadata lists the parameters.",
            code="search_parameter_unsupported",
            parameters=list(dict.fromkeys(ignored)),
        )
    return SearchQuery(
        _search(reading), reading.count, reading.cursor, tuple(used), tuple(dict.fromkeys(ignored))
    )


def _is_supported(name: str, value: str) -> bool:
    if name == "_sort":
        return value == "date"  # the only order
    if name == "_total":
        return value == "none"
    return name in READERS


def _search(reading: _Reading) -> IntakeSearch:
    chosen = reading.chosen
    if not reading.provisional:
        chosen = replace(chosen, item_ids=frozenset())  # no record has this state
    elif len(reading.provisional) == 1:
        chosen = replace(chosen, provisional=reading.provisional.pop())
    return IntakeSearch(tuple(reading.people), chosen)


def _read_person(reading: _Reading, name: str, value: str) -> None:
    """Read a reference: Patient/ID, a Patient's URL, or an id; also `system|code`, which is no reference."""

    def person(text: str) -> PersonName:
        if "|" in text:
            return person_of_token(reading.names, text) or NOBODY
        own = text.removeprefix(f"{reading.names.base}/")
        kind, slash, logical_id = own.rpartition("/")
        if slash and kind != "Patient":
            return NOBODY  # a Group, or another server's
        return person_of_id(logical_id) or NOBODY

    reading.people.append(tuple(person(text) for text in _values(name, value)))


def _read_person_token(reading: _Reading, name: str, value: str) -> None:
    reading.people.append(
        tuple(person_of_token(reading.names, text) or NOBODY for text in _values(name, value))
    )


def _read_date(reading: _Reading, name: str, value: str) -> None:
    if "," in value:
        raise _invalid(name, "takes one value; several of them must all be met")
    reading.chosen = add_date(reading.chosen, value)


def _read_status(reading: _Reading, name: str, value: str) -> None:
    codes = [text.removeprefix(f"{EVENT_STATUS}|") for text in _values(name, value)]
    for code in codes:
        if code not in STATUSES:
            raise _invalid(name, f"has no code {code!r}; these are: {', '.join(STATUSES)}")
    reading.provisional &= {PROVISIONAL[code] for code in codes if code in PROVISIONAL}


def _read_ids(reading: _Reading, name: str, value: str) -> None:
    item_ids = frozenset(
        item_id for text in _values(name, value) if (item_id := _id(text)) is not None
    )
    if reading.chosen.item_ids is not None:
        item_ids &= reading.chosen.item_ids
    reading.chosen = replace(reading.chosen, item_ids=item_ids)


def _read_identifier(reading: _Reading, name: str, value: str) -> None:
    system = f"{reading.names.system('items')}|"
    _read_ids(reading, name, ",".join(text.removeprefix(system) for text in _values(name, value)))


def _read_count(reading: _Reading, name: str, value: str) -> None:
    if not (value.isascii() and value.isdecimal()) or not int(value[:9]):
        raise _invalid(name, "is a number of resources, at least 1; totals are not counted")
    reading.count = min(int(value[:9]), MOST_COUNT)


def _read_cursor(reading: _Reading, _: str, value: str) -> None:
    reading.cursor = value


def _read_nothing(_: _Reading, __: str, ___: str) -> None:
    """The value is the default."""


def _id(text: str) -> uuid.UUID | None:
    """Read an id as this server writes it; None if it is no such id."""
    try:
        item_id = uuid.UUID(text)
    except ValueError:
        return None
    return item_id if str(item_id) == text else None


def _values(name: str, value: str) -> Sequence[str]:
    values = value.split(",")
    if len(values) > MOST_VALUES or not all(values):
        raise _invalid(
            name, f"takes up to {MOST_VALUES} values, separated by commas, none of them empty"
        )
    return values


def _invalid(name: str, why: str) -> MalformedRequestError:
    return MalformedRequestError(f"{name} {why}.", code="search_parameter_invalid", parameter=name)


READERS: Mapping[str, Callable[[_Reading, str, str], None]] = {
    **dict.fromkeys(("subject", "patient", "subject:Patient"), _read_person),
    **dict.fromkeys(
        (
            "subject:identifier", "patient:identifier", "subject.identifier", "patient.identifier",
            "subject:Patient.identifier",
        ),
        _read_person_token,
    ),
    "date": _read_date,
    "status": _read_status,
    "_id": _read_ids,
    "identifier": _read_identifier,
    "_count": _read_count,
    CURSOR: _read_cursor,
    "_sort": _read_nothing,
    "_total": _read_nothing,
}  # fmt: skip
