"""What a form sends, checked by the same schema as the API's body; a refused value keeps what was typed beside it."""

from collections.abc import Mapping
from typing import Annotated, TypeVar

from fastapi import Depends, Request
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData

from app.core.errors import MalformedRequestError
from app.dashboard.refusals import sentences

FORM = "application/x-www-form-urlencoded"  # no page of ours sends files
MOST_FIELDS = 1000

Model = TypeVar("Model", bound=BaseModel)


async def form_fields(request: Request) -> FormData:
    """The fields of a form. Raises MalformedRequestError."""
    content_type = request.headers.get("content-type", FORM).partition(";")[0].strip().lower()
    if content_type != FORM:
        raise MalformedRequestError(f"A form of these pages is sent as {FORM}.")
    return await request.form(max_fields=MOST_FIELDS, max_files=0)


Fields = Annotated[FormData, Depends(form_fields)]


def typed(fields: FormData) -> dict[str, str]:
    """What was typed, blanks around it cut off."""
    return {name: value.strip() for name, value in fields.multi_items() if isinstance(value, str)}


def take_version(values: dict[str, str]) -> frozenset[int]:
    """Take the version that the form was opened at out of its values; where it names none, a change is refused."""
    version = values.pop("version", "")
    return frozenset({int(version)}) if version.isdecimal() else frozenset()


def checked(model: type[Model], values: Mapping[str, object]) -> tuple[Model | None, dict[str, str]]:
    """(the body, nothing), or (None, field -> what is wrong with it).

    An empty field says nothing: its default holds.
    """
    told = {name: value for name, value in values.items() if value != ""}
    try:
        return model.model_validate(told), {}
    except ValidationError as error:
        return None, sentences(error.errors())
