"""The metadata part's bytes to a checked MealMetadata, or an error with its code and place."""

import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from app.http.metadata import validated_with_unknown
from app.meals.meal_time import meal_time
from app.records.meal_schemas import MealMetadataIn, NewMealMetadataIn
from app.uploads.submit_meal import MealMetadata
from app.vision.marker_spec import parse_marker


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
