"""Metadata of an after-meal pair over the wire."""

import uuid
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.http.text_schemas import Instant, Text
from app.people.calibration_schemas import CameraIn
from app.records.meal_schemas import MAX_HINTS, HintIn, PosesIn


class AfterHintIn(HintIn):
    """Where something was left in the photograph after_left, upright pixels, and what it is, as far as it is known."""

    model_config = ConfigDict(extra="forbid", validate_by_name=True)

    item: uuid.UUID | None = Field(
        default=None, description="The item of the meal that it was left of."
    )
    leftover_class: Literal["food_left", "refuse"] | None = Field(
        default=None, alias="class", description="refuse: peel, core, bone, shell: it is not eaten."
    )


class AfterMetadataIn(BaseModel):
    """Told before the second photograph of the pair, or not at all."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "captured_at": "2026-11-21T12:55:00+08:00",
                "hints": [
                    {
                        "point": [812, 560],
                        "item": "43f0e3b7-0be6-52f3-b3a7-7d1ecccce470",
                        "class": "refuse",
                    }
                ],
            }
        },
    )

    captured_at: Instant = Field(description="When after_left was taken: RFC 3339 with offset.")
    time_zone: Text | None = Field(
        default=None, min_length=1, max_length=64, description="IANA name; default: the meal's."
    )
    hints: list[AfterHintIn] = Field(
        default_factory=list,
        max_length=MAX_HINTS,
        description="What the person knows of some of the leftovers; the others are looked for all the same.",
    )
    complete: bool = Field(
        default=False,
        strict=True,
        description="Whether the hints are all that is left: nothing else is looked for.",
    )
    camera: CameraIn | None = Field(default=None, description="Default: the meal's.")
    poses: PosesIn | None = Field(
        default=None, description="Of this pair's photographs, as those of a meal."
    )
