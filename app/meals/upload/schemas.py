"""What phones send beside a meal's own metadata, over the wire.

An after-meal pair's metadata, a meal without photographs, a check of a pair; and what the server
can do, which an app reads at its start.
"""

import uuid
from datetime import datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.http.closed_model import ClosedModel
from app.http.text_schemas import Instant, Text
from app.people.calibration_schemas import CameraIn
from app.people.models import Locale
from app.records.meal_schemas import MAX_HINTS, HintIn, LocationIn, PosesIn
from app.records.review.schemas import AmountIn, FoodKey, Share


class AfterHintIn(HintIn):
    """Where something was left in the photograph after_left, upright pixels, and what it is, as far as it is known."""

    model_config = ConfigDict(validate_by_name=True)

    item: uuid.UUID | None = Field(
        default=None, description="The item of the meal that it was left of."
    )
    leftover_class: Literal["food_left", "refuse"] | None = Field(
        default=None, alias="class", description="refuse: peel, core, bone, shell: it is not eaten."
    )


class AfterMetadataIn(ClosedModel):
    """Told before the second photograph of the pair, or not at all."""

    model_config = ConfigDict(
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


class DeclaredItemIn(ClosedModel):
    """A food and how much of it; without an amount the meal needs review."""

    food: FoodKey
    amount: AmountIn | None = Field(
        default=None,
        description="How much of it there was; null: not known, and the meal needs review.",
    )
    share: Share = Field(
        default=1.0, description="The participant's share of it, above 0 to 1; 1: all of it."
    )
    copied: bool = Field(
        default=False,
        description="Food and amount were taken from a former meal or a favourite: flag `copied`.",
    )


class FavouriteIn(ClosedModel):
    """Foods and amounts under a name, to be entered again."""

    name: Text = Field(min_length=1, max_length=100, description="The participant's name for it.")
    items: list[DeclaredItemIn] = Field(
        min_length=1,
        max_length=50,
        description="Its foods, as a meal without photographs has them.",
    )


class FavouriteList(ClosedModel):
    """A participant's favourites, in their own order."""

    items: list[FavouriteIn] = Field(max_length=100, description="The favourites.")


class DeclaredMealIn(ClosedModel):
    """An occasion without photographs."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "5a8b8a0e-54a5-4c5c-9a1e-6c3c1d7a2f10",
                "captured_at": "2026-11-21T16:00:00+08:00",
                "time_zone": "Asia/Shanghai",
                "items": [
                    {"food": "milk-whole", "amount": {"volume_ml": 250}},
                    {"food": "cookie-plain", "amount": {"mass_g": 24, "relative_sd": 0.1}},
                ],
            }
        },
    )

    id: uuid.UUID = Field(
        description="Made by the phone, once a meal; the same id again is the same meal."
    )
    captured_at: Instant = Field(description="When it was eaten: RFC 3339 with offset.")
    time_zone: Text = Field(
        min_length=1, max_length=64, description="IANA name, such as Asia/Shanghai."
    )
    items: list[DeclaredItemIn] = Field(
        min_length=1, max_length=50, description="The foods of the meal."
    )
    location: LocationIn | None = Field(
        default=None, description="Where it was eaten; kept only if the study keeps locations."
    )
    app_version: Text | None = Field(
        default=None, max_length=64, description="The version of the phone's app."
    )


class CheckMetadataIn(ClosedModel):
    """The metadata of a check; every field is optional."""

    model_config = ConfigDict(json_schema_extra={"example": {"locale": "es"}})

    marker: Text | None = Field(
        default=None,
        max_length=64,
        description="The board, such as plain:9x7:11, or a coin, such as coin:eur-1; default: "
        "the study's.",
    )
    camera: CameraIn | None = Field(
        default=None, description="Default: as for a meal of this phone."
    )
    locale: Locale | None = Field(
        default=None, description="Of the sentences; default: Accept-Language, or else the study's."
    )


class CheckProblemOut(BaseModel):
    """One thing to do better."""

    code: str = Field(description="Stable; docs/checks.md and docs/errors.md list them.")
    severity: Literal["stop", "warn"] = Field(
        description="stop: this pair will not be measured. warn: it will be, but worse."
    )
    side: Literal["left", "right"] | None = Field(description="The photograph; null: the pair.")
    message: str = Field(description="One sentence for the participant.")


class CheckOut(BaseModel):
    """The result of a check. Nothing of the pair was kept."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "ok": False,
                "problems": [
                    {
                        "code": "marker_cut_off",
                        "severity": "stop",
                        "side": "left",
                        "message": "The printed pattern is cut off at the edge in the left photo: please step back a "
                        "little or move the phone.",
                    }
                ],
                "measures": {"edge_width_px_right": 3.9, "square_px_right": 58.1},
                "locale": "en",
                "seconds": 0.31,
            }
        }
    )

    ok: bool = Field(description="Nothing stops this pair from being measured.")
    problems: list[CheckProblemOut] = Field(description="Problems of the pair; empty: none.")
    measures: dict[str, float] = Field(
        description="Measured numbers, each with its unit in the name."
    )
    locale: Locale = Field(description="Of the sentences.")
    seconds: float = Field(description="Duration of the check, without the upload.")


class ServerLimitsOut(BaseModel):
    """What an app should know before it sends."""

    photo_bytes: int = Field(description="The largest photograph, bytes.")
    photo_pixels: int = Field(description="The most pixels of a photograph.")
    metadata_bytes: int = Field(description="The largest metadata part, bytes.")
    hints: int = Field(description="The most hints of a meal.")
    wait_seconds: int = Field(description="The longest `?wait=`.")


class ServerOut(BaseModel):
    """A server's version and abilities: an app reads them at its start, before it relies on something new."""

    version: str = Field(description="The program's, such as 0.4.0.")
    api_versions: list[str] = Field(description="Of the addresses that it answers: `v1` is /v1.")
    time: datetime = Field(description="The server's clock: compare it with the phone's.")
    image_types: list[str] = Field(description="Of the photographs that it reads.")
    metadata_fields: list[str] = Field(
        description="Those of a meal's metadata that it knows; others come back as ignored."
    )
    hint_fields: list[str] = Field(description="Those of a hint that it knows.")
    features: list[str] = Field(
        description="What it can do, each by a name that never changes its meaning."
    )
    limits: ServerLimitsOut = Field(description="How large and how much it takes at most.")
