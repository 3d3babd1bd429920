"""Forms: fields as a browser sends them, checked by the same schema as the API's body.

A refused form is a WrongFormError, which names each wrong field; a page shows the sentences beside what was entered.
"""

from collections.abc import Mapping
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


def wrong_fields(error: TadaError, field: str = "") -> dict[str, str]:
    """Return field -> sentence for a refused form; field: where the message of any other error belongs."""
    return error.wrong if isinstance(error, WrongFormError) else {field: error.message}
