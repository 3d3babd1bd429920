"""The query of GET /fhir/NutritionIntake -> what is asked for, and which parameters were used for it.

A parameter that this server does not know is ignored, and said to be, or refused where the caller wants that
(`Prefer: handling=strict`). A value that cannot be read is always refused: without its filter the answer would be
another one.
"""

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from app.core.errors import MalformedRequestError
from app.exports.fhir.dates import narrowed
from app.exports.fhir.fhir_intakes import IntakeSearch, PersonName
from app.exports.fhir.names import EVENT_STATUS, Names, person_of_id, person_of_token
from app.exports.fhir.queries import IntakeFilter

DEFAULT_COUNT, MOST_COUNT = 50, 100
MOST_VALUES = 50  # of one parameter, comma between
CURSOR = "_cursor"
STATUSES = (
    "preparation", "in-progress", "not-done", "on-hold", "stopped", "completed", "entered-in-error", "unknown",
)  # fmt: skip
PROVISIONAL = {"in-progress": True, "completed": False}
OF_ANY_REQUEST = frozenset({"_format", "_pretty"})  # say nothing of what is asked for
NOBODY = PersonName("", "")  # whom no participant is called


@dataclass(frozen=True, slots=True)
class Asked:
    """used: the parameters that had a say, as they came. ignored: names of the others."""

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


def read_search(parameters: Iterable[tuple[str, str]], names: Names, *, is_strict: bool) -> Asked:
    """What the query asks for.

    Raises MalformedRequestError: `search_parameter_invalid`, and if is_strict `search_parameter_unsupported`.
    """
    reading, used, ignored = _Reading(names), [], []
    for name, value in parameters:
        if name in OF_ANY_REQUEST:
            continue
        if not _is_known(name, value):
            ignored.append(name)
            continue
        if not value:
            raise _invalid(name, "has no value")
        READERS[name](reading, name, value)
        if name != CURSOR:
            used.append((name, value))
    if ignored and is_strict:
        raise MalformedRequestError(
            f"Not supported here: {', '.join(dict.fromkeys(ignored))}. GET /fhir/metadata lists what is.",
            code="search_parameter_unsupported",
            parameters=list(dict.fromkeys(ignored)),
        )
    return Asked(_search(reading), reading.count, reading.cursor, tuple(used), tuple(dict.fromkeys(ignored)))


def _is_known(name: str, value: str) -> bool:
    if name == "_sort":
        return value == "date"  # the one order that there is
    if name == "_total":
        return value == "none"
    return name in READERS


def _search(reading: _Reading) -> IntakeSearch:
    chosen = reading.chosen
    if not reading.provisional:
        chosen = replace(chosen, item_ids=frozenset())  # a state that no record is in
    elif len(reading.provisional) == 1:
        chosen = replace(chosen, provisional=reading.provisional.pop())
    return IntakeSearch(tuple(reading.people), chosen)


def _read_person(reading: _Reading, name: str, value: str) -> None:
    """A reference: Patient/ID, the whole URL of one, or an id; `system|code` too, which no reference looks like."""

    def person(text: str) -> PersonName:
        if "|" in text:
            return person_of_token(reading.names, text) or NOBODY
        own = text.removeprefix(f"{reading.names.base}/")
        kind, slash, logical_id = own.rpartition("/")
        if slash and kind != "Patient":
            return NOBODY  # a Group, or of another server
        return person_of_id(logical_id) or NOBODY

    reading.people.append(tuple(person(text) for text in _values(name, value)))


def _read_person_token(reading: _Reading, name: str, value: str) -> None:
    reading.people.append(tuple(person_of_token(reading.names, text) or NOBODY for text in _values(name, value)))


def _read_date(reading: _Reading, name: str, value: str) -> None:
    if "," in value:
        raise _invalid(name, "takes one value; several of them must all be met")
    reading.chosen = narrowed(reading.chosen, value)


def _read_status(reading: _Reading, name: str, value: str) -> None:
    codes = [text.removeprefix(f"{EVENT_STATUS}|") for text in _values(name, value)]
    for code in codes:
        if code not in STATUSES:
            raise _invalid(name, f"has no code {code!r}; these are: {', '.join(STATUSES)}")
    reading.provisional &= {PROVISIONAL[code] for code in codes if code in PROVISIONAL}


def _read_ids(reading: _Reading, name: str, value: str) -> None:
    found = (_id(text) for text in _values(name, value))
    named = frozenset(each for each in found if each is not None)
    if reading.chosen.item_ids is not None:
        named &= reading.chosen.item_ids
    reading.chosen = replace(reading.chosen, item_ids=named)


def _read_identifier(reading: _Reading, name: str, value: str) -> None:
    system = f"{reading.names.system('items')}|"
    _read_ids(reading, name, ",".join(text.removeprefix(system) for text in _values(name, value)))


def _read_count(reading: _Reading, name: str, value: str) -> None:
    if not (value.isascii() and value.isdecimal()) or not int(value[:9]):
        raise _invalid(name, "is a number of resources, from 1 on; what it comes to in all is not counted")
    reading.count = min(int(value[:9]), MOST_COUNT)


def _read_cursor(reading: _Reading, _: str, value: str) -> None:
    reading.cursor = value


def _read_nothing(_: _Reading, __: str, ___: str) -> None:
    """What is so anyhow."""


def _id(text: str) -> uuid.UUID | None:
    """An id as this server writes it; None: of nothing here."""
    try:
        found = uuid.UUID(text)
    except ValueError:
        return None
    return found if str(found) == text else None


def _values(name: str, value: str) -> Sequence[str]:
    values = value.split(",")
    if len(values) > MOST_VALUES or not all(values):
        raise _invalid(name, f"takes up to {MOST_VALUES} values, comma between, none of them empty")
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
