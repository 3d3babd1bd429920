"""Forms: fields as a browser sends them, checked by the same schema as the API's body.

A refused form is a WrongFormError, which names each wrong field; a page shows the sentences beside
what was entered. The API's problem documents keep pydantic's own messages, for programs and their
authors. A field may have a structure: a number, or lines of parts separated by semicolons.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final, TypeVar

from fastapi import Depends, Request
from pydantic import BaseModel, BeforeValidator, ValidationError
from pydantic_core import ErrorDetails
from starlette.datastructures import FormData

from app.core.errors import InvalidInputError, MalformedRequestError, TadaError

A_DAY: Final = "Write a day as 2026-11-30."
A_MOMENT: Final = "Write a day and a time as 2026-11-30T12:30:00+01:00."
WHOLE: Final = "Write a whole number, such as 4."
A_NUMBER: Final = "Write a number, such as 4.6."

# by a schema's pattern; tests/unit/dashboard/test_refusals.py compares them with the forms' schemas
PATTERNS: Final[Mapping[str, str]] = {
    r"^[A-Za-z0-9][A-Za-z0-9_-]*$": "Letters A-Z, digits, - and _ only, beginning with a letter or digit; no blanks.",
    r"^[a-z0-9][a-z0-9._-]{0,63}$": (
        "Small letters a-z, digits, dot, _ and - only, beginning with a letter or digit; no blanks, 64 characters at "
        "most."
    ),
    r"^(?:(?:0\d|1[01]):[0-5]\d|12:00)$": "Write a time from 00:00 to 12:00, as 03:00.",
    r"^(?:[01]\d|2[0-3]):[0-5]\d$": "Write times from 00:00 to 23:59, as 12:30.",
}
_SENTENCES: Final[Mapping[str, str]] = {
    "missing": "This field is required.",
    "extra_forbidden": "This field is not allowed here.",
    "bool_parsing": "Write true or false.",
    "uuid_parsing": "This is not an id.",
    "uuid_type": "This is not an id.",
    "string_type": "Write text.",
    "int_type": WHOLE,
    "int_parsing": WHOLE,
    "int_parsing_size": WHOLE,
    "int_from_float": WHOLE,
    "float_type": A_NUMBER,
    "float_parsing": A_NUMBER,
    "finite_number": A_NUMBER,
    "union_tag_invalid": "There is no such choice.",
    "union_tag_not_found": "There is no such choice.",
}
# {} is the number that pydantic's message names first
_LIMITS: Final[Mapping[str, str]] = {
    "greater_than": "This must be more than {}.",
    "greater_than_equal": "This must be {} or more.",
    "less_than": "This must be less than {}.",
    "less_than_equal": "This must be {} or less.",
    "string_too_short": "Letters or digits are missing: {} at least.",
    "string_too_long": "This is too long: {} characters at most.",
    "too_short": "Choose {} at least.",
    "too_long": "Choose {} at most.",
}
_LIMIT_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_CHOICE = re.compile(r"'([^']*)'")
_PLACES = frozenset({"query", "path", "body", "header"})
FORM = "application/x-www-form-urlencoded"  # files are received by http/upload.py
MOST_FIELDS = 1000

Model = TypeVar("Model", bound=BaseModel)

# browsers send an empty field as ""
Blank = BeforeValidator(
    lambda value: None if isinstance(value, str) and not value.strip() else value
)
T = TypeVar("T")

_NUMBER = re.compile(r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_DECIMAL_COMMA = re.compile(r"-?(?:0?,\d+|\d+,(?!\d{3}$)\d+)")


def sentence(kind: str, message: str) -> str:
    """Return what to enter instead. kind, message: pydantic's error type and message."""
    if kind in _SENTENCES:
        return _SENTENCES[kind]
    if kind in _LIMITS and (limit := _LIMIT_NUMBER.search(message)) is not None:
        if kind == "string_too_short" and limit[0] == "1":
            return "This must not be empty."
        return _LIMITS[kind].format(limit[0])
    if kind.startswith("date_"):
        return A_DAY
    if kind.startswith("datetime_"):
        return A_MOMENT
    if kind in ("literal_error", "enum"):
        choices = [choice.replace("_", " ") for choice in _CHOICE.findall(message)]
        return f"There is no such choice; choose: {', '.join(choices)}."
    if kind == "string_pattern_mismatch":
        matches = (text for pattern, text in PATTERNS.items() if f"'{pattern}'" in message)
        return next(matches, "It contains a character that is not allowed here.")
    own_message = message.removeprefix("Value error, ").rstrip(".")
    return f"{own_message[:1].upper()}{own_message[1:]}."


def sentences(errors: Sequence[ErrorDetails]) -> dict[str, str]:
    """Return field -> sentence for pydantic's errors; a sentence about a part of a field begins with its name."""
    wrong: dict[str, list[str]] = {}
    for error in errors:
        field, *inner = error["loc"] or ("",)
        parts = ", ".join(part.replace("_", " ") for part in inner if isinstance(part, str))
        text = sentence(error["type"], error["msg"])
        wrong.setdefault(str(field), []).append(f"{parts}: {text}" if parts else text)
    return {field: " ".join(dict.fromkeys(texts)) for field, texts in wrong.items()}


def sentence_of_request(errors: Sequence[Mapping[str, object]]) -> str | None:
    """Return the first of a problem document's `errors` as a sentence that names the parameter; None without errors.

    The API's "query.from" is "From" on a page.
    """
    if not errors:
        return None
    first = errors[0]
    parts = [
        part for part in str(first["at"]).split(".") if part not in _PLACES and not part.isdecimal()
    ]
    text = sentence(str(first["type"]), str(first["message"]))
    name = parts[0].replace("_", " ") if parts else ""
    return f"{name[:1].upper()}{name[1:]}: {text}" if name else text


class WrongFormError(InvalidInputError):
    """Fields of a form cannot be accepted. wrong: field -> what is wrong with it."""

    def __init__(self, wrong: Mapping[str, str]) -> None:
        super().__init__("; ".join(wrong.values()))
        self.wrong = dict(wrong)


async def form_fields(request: Request) -> FormData:
    """Return the fields of a form. Raises MalformedRequestError."""
    content_type = request.headers.get("content-type", FORM).partition(";")[0].strip().lower()
    if content_type != FORM:
        raise MalformedRequestError(f"A form of these pages is sent as {FORM}.")
    return await request.form(max_fields=MOST_FIELDS, max_files=0)


Fields = Annotated[FormData, Depends(form_fields)]


def form_values(fields: FormData) -> dict[str, str]:
    """Return field -> text without surrounding blanks; the last one of a field that is sent several times."""
    return {name: value.strip() for name, value in fields.multi_items() if isinstance(value, str)}


def take_version(values: dict[str, str]) -> frozenset[int]:
    """Remove the version with which the form was opened from its values; without one no version matches."""
    version = values.pop("version", "")
    return frozenset({int(version)}) if version.isdecimal() else frozenset()


def read_form(
    model: type[Model], values: Mapping[str, object], wrong: Mapping[str, str] | None = None
) -> Model:
    """Validate a form's values; an empty field keeps its default.

    wrong: fields whose text could not be parsed. Raises WrongFormError for those and for what the
    model refuses.
    """
    wrong = wrong or {}
    try:
        body = model.model_validate({name: value for name, value in values.items() if value != ""})
    except ValidationError as error:
        raise WrongFormError({**sentences(error.errors()), **wrong}) from None
    if wrong:
        raise WrongFormError(wrong)
    return body


@dataclass(frozen=True, slots=True)
class FormState:
    """What a page's form shows.

    values: as they were entered
    wrong: field -> what is wrong with it; "": with the form as a whole
    status: of the page with a refused form; else 0
    """

    values: Mapping[str, object] = field(default_factory=dict)
    wrong: Mapping[str, str] = field(default_factory=dict)
    status: int = 0


EMPTY_FORM = FormState()


def refused(
    error: TadaError, values: Mapping[str, object] = EMPTY_FORM.values, name: str = ""
) -> FormState:
    """Return a refused form with its values. name: the field to which any other error belongs."""
    wrong = error.wrong if isinstance(error, WrongFormError) else {name: error.message}
    return FormState(values, wrong, error.status)


class WrongFieldError(ValueError):
    """The text of a field cannot be read; the message says why."""


def with_point(text: str) -> str:
    """Return a number that has a decimal comma with a point; `1,500` stays as it is, for it may be 1500."""
    return text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text


def number(text: str) -> float:
    """Read a number such as `4.6` or `4,6`. Raises WrongFieldError."""
    text = with_point(text)
    if not _NUMBER.fullmatch(text):
        raise WrongFieldError(f"“{text[:40]}” is no number: write it as 4.6.")
    return float(text)


def read_fields(
    texts: Mapping[str, str], readers: Mapping[str, Callable[[str], T]]
) -> tuple[dict[str, T], dict[str, str]]:
    """Return (field -> value, field -> why it cannot be read) for the texts that have a reader."""
    values: dict[str, T] = {}
    wrong: dict[str, str] = {}
    for name, text in texts.items():
        if name in readers:
            try:
                values[name] = readers[name](text)
            except WrongFieldError as error:
                wrong[name] = str(error)
    return values, wrong


def entries(text: str, names: Sequence[str], *, needed: int | None = None) -> list[dict[str, str]]:
    """Return each line of a text area as name -> part; `needed` parts are required, later ones may be missing.

    Raises WrongFieldError, which names the line.
    """
    rows = []
    for place, line in enumerate(lines(text), start=1):
        parts = [part.strip() for part in line.split(";", len(names) - 1)]
        if len(parts) < (needed or len(names)):
            raise WrongFieldError(
                f"Line {place} needs: {'; '.join(names[: needed or len(names)])}."
            )
        rows.append(dict(zip(names, parts, strict=False)))
    return rows


def lines(text: str) -> list[str]:
    """Return the lines that are not blank."""
    return [line.strip() for line in text.splitlines() if line.strip()]


def text_of(rows: Iterable[Sequence[object]]) -> str:
    """Format rows for a text area, so that `entries` reads them back."""
    return "\n".join("; ".join(shown(part) for part in row) for row in rows)


def shown(value: object) -> str:
    """Format a part so that it reads back as the same value."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
