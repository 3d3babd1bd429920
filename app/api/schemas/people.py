"""Studies, participants, enrolment over the wire."""

import uuid
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas.text import Text

Code = Annotated[
    str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", description="Letters, digits, - _")
]


class StudyIn(BaseModel):
    """A new study."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"code": "pilot", "name": "Pilot study", "marker": "plain:9x7:11"}},
    )

    code: Code
    name: Text = Field(min_length=1, max_length=200)
    marker: Text | None = Field(default=None, max_length=64, description="The board that participants are given.")
    location_policy: Literal["drop", "keep"] = "drop"


class StudyOut(BaseModel):
    """A study."""

    code: str
    name: str
    marker: str | None
    location_policy: str
    created_at: datetime


class StudyList(BaseModel):
    """All studies."""

    items: list[StudyOut]


class ParticipantIn(BaseModel):
    """A new participant, by a code that says nothing about the person."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"code": "P001"}})

    code: Code


class EnrolmentCodeOut(BaseModel):
    """A one-time code for a participant's next device, shown once."""

    code: str
    expires_at: datetime


class EnrolmentIn(BaseModel):
    """A device exchanges its code for a token."""

    model_config = ConfigDict(extra="forbid")

    code: Text = Field(min_length=1, max_length=100)
    device_name: Text = Field(min_length=1, max_length=200, description="Such as the phone's model.")


class EnrolmentOut(BaseModel):
    """The device's token, shown once; marker: the study's board."""

    token: str
    device_id: uuid.UUID
    study: str
    participant: str
    marker: str | None
