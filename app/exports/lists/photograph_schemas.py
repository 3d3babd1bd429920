"""Schemas of the image manifest."""

import uuid
from datetime import datetime

from pydantic import BaseModel, Field

from app.http.field_descriptions import (
    MEAL_ID,
    PHOTOGRAPH,
    STUDY,
    CapturedAt,
    LocalDate,
    ParticipantCode,
)
from app.http.page_of import PageOf
from app.photos.slots import ImageSlot


class PhotographOut(BaseModel):
    """A photograph, depth map or voice note as it arrived and as it is stored."""

    meal_id: uuid.UUID = Field(description=MEAL_ID)
    study: str = Field(description=STUDY)
    participant: ParticipantCode
    captured_at: CapturedAt
    local_date: LocalDate
    slot: ImageSlot = Field(description=PHOTOGRAPH["slot"])
    media_type: str = Field(description=PHOTOGRAPH["media_type"])
    width_px: int = Field(description=PHOTOGRAPH["width_px"])
    height_px: int = Field(description=PHOTOGRAPH["height_px"])
    bytes: int = Field(description="Length as stored.")
    received_sha256: str = Field(description="SHA-256 of the bytes that the phone sent.")
    stored_sha256: str = Field(
        description="SHA-256 of the stored bytes, which differ if the location was removed."
    )
    received_at: datetime = Field(description=PHOTOGRAPH["received_at"])
    erased: bool = Field(description=PHOTOGRAPH["erased"])
    erased_at: datetime | None = Field(description=PHOTOGRAPH["erased_at"])
    path: str | None = Field(
        description="Path of the picture, re-encoded as JPEG, or of a map's or voice note's file; null: it was erased."
    )


class PhotographPage(PageOf[PhotographOut]):
    """Photographs in the order of capture; `next` leads to the page after it, null at the end."""

    next: str | None = Field(description="The next page's path and query.")
