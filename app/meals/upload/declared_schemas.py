"""A meal that is entered without photographs, over the wire."""

import uuid

from pydantic import BaseModel, ConfigDict, Field

from app.http.text_schemas import Instant, Text
from app.records.meal_schemas import LocationIn
from app.records.review.schemas import AmountIn, FoodKey, Share


class DeclaredItemIn(BaseModel):
    """A food and how much of it; without an amount the meal needs review."""

    model_config = ConfigDict(extra="forbid")

    food: FoodKey
    amount: AmountIn | None = Field(
        default=None,
        description="How much of it there was; null: not known, and the meal needs review.",
    )
    share: Share = Field(
        default=1.0, description="The participant's share of it, above 0 to 1; 1: all of it."
    )


class DeclaredMealIn(BaseModel):
    """An occasion without photographs."""

    model_config = ConfigDict(
        extra="forbid",
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
