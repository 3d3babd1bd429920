"""A metadata part's bytes as its model: unknown fields kept aside, every error with its code and place."""

import json
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from app.core.errors import InvalidInputError, MalformedRequestError, TooLargeError
from app.http.problems import value_problems

Model = TypeVar("Model", bound=BaseModel)
MAX_UNKNOWN = 50  # fields: more are no newer app
MAX_NAME = 200


async def read_limited(request: Request, limit_bytes: int) -> bytes:
    """The whole body, if it is no larger than the limit. Raises TooLargeError."""
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit_bytes:
            raise TooLargeError(
                f"The metadata is larger than {limit_bytes} bytes, the limit.",
                code="metadata_too_large",
                limit_bytes=limit_bytes,
            )
    return bytes(body)


def validated_with_unknown(model: type[Model], body: bytes) -> tuple[Model, dict[str, Any]]:
    """A metadata part as its model, and what the model has no field for, by its place.

    So that a newer app is heard by an older server. Raises what `validated` does;
    `metadata_field_unknown` where there are more than MAX_UNKNOWN of them.
    """
    try:
        return model.model_validate_json(body), {}
    except ValidationError as error:
        places = [item["loc"] for item in error.errors() if item["type"] == "extra_forbidden"]
    if not 0 < len(places) <= MAX_UNKNOWN:
        return validated(model, body), {}
    document = json.loads(body)  # it was JSON to pydantic
    unknown = {}
    for place in places:
        holder = document
        for part in place[:-1]:
            holder = holder[part]
        unknown[".".join(map(str, place))[:MAX_NAME]] = holder.pop(place[-1])
    return validated(model, json.dumps(document).encode()), unknown


def validated(model: type[Model], body: bytes) -> Model:
    """A metadata part as its model.

    Raises MalformedRequestError, InvalidInputError with the places.
    """
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        problems = value_problems(error.errors())
    first = problems[0]
    if first["type"] == "json_invalid":
        raise MalformedRequestError(
            f"The metadata is not JSON: {first['message']}.", code="metadata_not_json"
        )
    unknown = [problem["at"] for problem in problems if problem["type"] == "extra_forbidden"]
    if unknown:
        raise InvalidInputError(
            f"The metadata has a field that is not known: {', '.join(unknown)}.",
            code="metadata_field_unknown",
            errors=problems,
        )
    place = f"metadata.{first['at']}" if first["at"] else "metadata"
    raise InvalidInputError(
        f"{place}: {first['message']}.", code="metadata_invalid", errors=problems
    )
