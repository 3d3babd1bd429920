"""The image manifest over the wire."""

import uuid
from datetime import date, datetime
from typing import Literal

from pydantic import BaseModel, Field


class PhotographOut(BaseModel):
    """One photograph as it arrived and as it is kept."""

    meal_id: uuid.UUID
    study: str
    participant: str
    captured_at: datetime
    local_date: date
    slot: Literal["left", "right", "after_left", "after_right"]
    media_type: str
    width_px: int
    height_px: int
    bytes: int = Field(description="As it is kept.")
    received_sha256: str = Field(description="Of the bytes that the phone sent.")
    stored_sha256: str = Field(description="Of the bytes that are kept: others where the location was cut out.")
    received_at: datetime
    erased: bool
    erased_at: datetime | None
    path: str | None = Field(description="Gives the picture, re-encoded as JPEG; null: it was erased.")


class PhotographPage(BaseModel):
    """Photographs in the order of capture; `next` leads to the page after it, null at the end."""

    items: list[PhotographOut]
    next: str | None = Field(description="The next page's path and query.")
