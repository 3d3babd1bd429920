"""The metadata part's bytes to a checked MealMetadata, or an error with its code and place."""

import json
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from app.core.errors import InvalidInputError, MalformedRequestError, TooLargeError
from app.meals.meal_time import meal_time
from app.records.meal_schemas import MealMetadataIn, NewMealMetadataIn
from app.uploads.submit_meal import MealMetadata
from app.vision.marker_spec import parse_marker

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


def parse_new_meal(body: bytes) -> MealMetadata:
    """The metadata part of POST /v1/meals."""
    checked, unknown = validated_with_unknown(NewMealMetadataIn, body)
    return to_metadata(checked.id, checked, unknown)


def parse_metadata(client_id: uuid.UUID, body: bytes) -> MealMetadata:
    """The body of PUT /v1/meals/{id}."""
    return to_metadata(client_id, *validated_with_unknown(MealMetadataIn, body))


def to_metadata(client_id: uuid.UUID, checked: MealMetadataIn, unknown: Mapping[str, Any]) -> MealMetadata:
    """From the wire's model to the service's. Raises InvalidInputError (time, zone, marker)."""
    if checked.marker is not None:
        parse_marker(checked.marker)
    return MealMetadata(
        client_id=client_id,
        time=meal_time(checked.captured_at, checked.time_zone, datetime.now(UTC)),
        marker=checked.marker,
        camera=checked.camera.model_dump(mode="json") if checked.camera else None,
        hints=tuple(hint.model_dump(mode="json", exclude_none=True) for hint in checked.hints),
        complete=checked.complete,
        location=checked.location.model_dump(exclude_none=True) if checked.location else None,
        app_version=checked.app_version,
        unknown=unknown,
    )


def validated_with_unknown(model: type[Model], body: bytes) -> tuple[Model, dict[str, Any]]:
    """A metadata part as its model, and what the model has no field for, by its place.

    So that a newer app is heard by an older server. Raises what `validated` does; `metadata_field_unknown` where there
    are more than MAX_UNKNOWN of them.
    """
    try:
        return model.model_validate_json(body), {}
    except ValidationError as error:
        places = [item["loc"] for item in error.errors() if item["type"] == "extra_forbidden"]
    if not 0 < len(places) <= MAX_UNKNOWN:
        return validated(model, body), {}
    told = json.loads(body)  # it was JSON to pydantic
    unknown = {}
    for place in places:
        holder = told
        for part in place[:-1]:
            holder = holder[part]
        unknown[".".join(map(str, place))[:MAX_NAME]] = holder.pop(place[-1])
    return validated(model, json.dumps(told).encode()), unknown


def validated(model: type[Model], body: bytes) -> Model:
    """A metadata part as its model. Raises MalformedRequestError, InvalidInputError with the places."""
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        problems = [
            {"at": ".".join(str(part) for part in item["loc"]), "message": item["msg"], "type": item["type"]}
            for item in error.errors(include_url=False, include_context=False, include_input=False)
        ]
    first = problems[0]
    if first["type"] == "json_invalid":
        raise MalformedRequestError(f"The metadata is not JSON: {first['message']}.", code="metadata_not_json")
    unknown = [problem["at"] for problem in problems if problem["type"] == "extra_forbidden"]
    if unknown:
        raise InvalidInputError(
            f"The metadata has a field that is not known: {', '.join(unknown)}.",
            code="metadata_field_unknown",
            errors=problems,
        )
    place = f"metadata.{first['at']}" if first["at"] else "metadata"
    raise InvalidInputError(f"{place}: {first['message']}.", code="metadata_invalid", errors=problems)
