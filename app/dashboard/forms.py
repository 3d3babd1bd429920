"""Forms: fields as a browser sends them, checked by the same schema as the API's body.

A refused form is a WrongFormError, which names each wrong field; a page shows the sentences beside what was
entered. A field may have a structure: a number, or lines of parts separated by semicolons.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

from fastapi import Depends, Request
from pydantic import BaseModel, BeforeValidator, ValidationError
from starlette.datastructures import FormData

from app.core.errors import InvalidInputError, MalformedRequestError, TadaError
from app.dashboard.refusals import sentences

FORM = "application/x-www-form-urlencoded"  # no page of ours sends files
MOST_FIELDS = 1000

Model = TypeVar("Model", bound=BaseModel)

# browsers send an empty field as ""
Blank = BeforeValidator(
    lambda value: None if isinstance(value, str) and not value.strip() else value
)
T = TypeVar("T")

_NUMBER = re.compile(r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_DECIMAL_COMMA = re.compile(r"-?(?:0?,\d+|\d+,(?!\d{3}$)\d+)")


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

    wrong: fields whose text could not be parsed. Raises WrongFormError for those and for what the model refuses.
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
