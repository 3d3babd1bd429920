"""What a server can do, over the wire."""

from datetime import datetime

from pydantic import BaseModel, Field


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
