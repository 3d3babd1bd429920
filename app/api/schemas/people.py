"""Studies, participants, phones and their enrolment over the wire."""

import uuid
from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas.meals import CameraIn
from app.api.schemas.text import LocalDay, Number, Text, unless_named
from app.nutrition.energy_requirement import HEIGHT_LIMITS_M, WEIGHT_LIMITS_KG, Activity, Trimester
from app.nutrition.life_stage import Sex

Code = Annotated[
    str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", description="Letters, digits, - _")
]
DayStart = Annotated[
    str,
    Field(
        pattern=r"^(?:(?:0\d|1[01]):[0-5]\d|12:00)$",
        description="HH:MM, 00:00 to 12:00: a meal before it belongs to the day before. Fixed once a meal is in.",
    ),
]


class ProtocolIn(BaseModel):
    """How a study measures. In a PATCH only the fields that are named change."""

    model_config = ConfigDict(extra="forbid")

    marker: Text | None = Field(
        default=None, max_length=64, description="The board that participants are given, such as plain:9x7:11."
    )
    camera: CameraIn | None = Field(
        default=None, description="Intrinsics that hold where neither the meal nor its phone has any."
    )
    expects_after_pair: bool = Field(default=False, description="Whether a second pair is taken after the meal.")
    after_window_minutes: int = Field(default=240, ge=5, le=2880, description="How long it is waited for.")
    location_policy: Literal["drop", "round", "keep"] = Field(
        default="drop",
        description="What is kept of where a meal was. With `drop` places of before are told no more, and exports with "
        "them expire; a release that was frozen with them keeps them.",
    )
    location_decimals: int | None = Field(
        default=None, ge=0, le=4, description="Of a degree, with `round` only: 2 are about a kilometre."
    )
    retention_days: int | None = Field(
        default=None, ge=1, le=36_500, description="Photographs go so many days after upload; null: they stay."
    )
    withdrawal_policy: Literal["keep", "anonymise", "erase"] = Field(
        default="erase", description="What happens to the data of a participant who leaves."
    )
    locale: Literal["en", "de", "es", "zh"] = Field(default="en", description="The participants' language.")
    gives_feedback: bool = Field(
        default=False, description="Whether participants see what they ate; it changes what people eat."
    )
    day_starts: DayStart = "00:00"
    shares_index: bool = Field(
        default=False,
        description="Whether all studies of this server learn from its confirmed items: from figures of what a food "
        "looked like, which food it was, its volume. Never photographs, nothing of persons.",
    )


class StudyIn(ProtocolIn):
    """A new study."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"code": "pilot", "name": "Pilot study", "marker": "plain:9x7:11"}},
    )

    code: Code
    name: Text = Field(min_length=1, max_length=200)


class StudyPatch(ProtocolIn):
    """A change of a study: only the fields that are named."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"location_policy": "round", "location_decimals": 2, "gives_feedback": True}},
    )

    name: Text = Field(default="", min_length=1, max_length=200, json_schema_extra=unless_named)


class StudyOut(BaseModel):
    """A study and its protocol. version: what its ETag names."""

    code: str
    name: str
    marker: str | None
    camera: CameraIn | None
    expects_after_pair: bool
    after_window_minutes: int
    location_policy: str
    location_decimals: int | None
    retention_days: int | None
    withdrawal_policy: str
    locale: str
    gives_feedback: bool
    day_starts: str
    shares_index: bool
    version: int
    created_at: datetime


class StudyList(BaseModel):
    """A page of studies."""

    items: list[StudyOut]
    next: str | None = None


class ProfileIn(BaseModel):
    """What reference intakes and plausibility need to know of a participant; all of it may be left out."""

    model_config = ConfigDict(extra="forbid")

    sex: Sex | None = None
    birth_year: int | None = Field(default=None, ge=1900, le=2200)
    height_cm: Number | None = Field(default=None, ge=100 * HEIGHT_LIMITS_M[0], le=100 * HEIGHT_LIMITS_M[1])
    weight_kg: Number | None = Field(
        default=None, ge=WEIGHT_LIMITS_KG[0], le=WEIGHT_LIMITS_KG[1], description="In pregnancy, the weight before it."
    )
    activity: Activity | None = None
    is_pregnant: bool | None = None
    trimester: Trimester | None = None
    is_lactating: bool | None = None
    lactation_months: int | None = Field(default=None, ge=0, le=60, description="Completed months since birth.")


class ParticipantIn(BaseModel):
    """A new participant, by a code that says nothing about the person."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"code": "P001"}})

    code: Code
    starts_on: LocalDay | None = Field(
        default=None, description="Local day that is day 1; null: that of the first meal."
    )
    profile: ProfileIn = Field(default_factory=ProfileIn)


class ParticipantPatch(BaseModel):
    """A change of a participant: only what is named. A key of the profile that is null is taken away."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"profile": {"sex": "female", "birth_year": 1990}}}
    )

    starts_on: LocalDay | None = Field(
        default=None, description="Local day that is day 1; null: that of the first meal."
    )
    profile: ProfileIn = Field(default_factory=ProfileIn)


class ParticipantRow(BaseModel):
    """A participant in a list. withdrawn_at: since when they have left the study."""

    code: str
    starts_on: date | None
    withdrawn_at: datetime | None
    created_at: datetime


class ParticipantOut(ParticipantRow):
    """A participant with their profile."""

    profile: ProfileIn


class ParticipantList(BaseModel):
    """A page of participants."""

    items: list[ParticipantRow]
    next: str | None


class EnrolmentCodeOut(BaseModel):
    """A one-time code for a participant's next device, shown once.

    qr_text: what the QR code says, JSON with server and code; qr_svg: the QR code itself, to stand in a page.
    """

    code: str
    expires_at: datetime
    qr_text: str
    qr_svg: str


class EnrolmentIn(BaseModel):
    """A device exchanges its code for a token."""

    model_config = ConfigDict(extra="forbid")

    code: Text = Field(min_length=1, max_length=100)
    device_name: Text = Field(min_length=1, max_length=200, description="Such as the phone's model.")
    model: Text | None = Field(default=None, min_length=1, max_length=200, description="The phone's model.")
    app_version: Text | None = Field(default=None, min_length=1, max_length=64)


class EnrolmentOut(BaseModel):
    """The device's token, shown once; marker: the study's board."""

    token: str
    device_id: uuid.UUID
    study: str
    participant: str
    marker: str | None


class PhoneOut(BaseModel):
    """A phone. clock_skew_seconds: its clock minus the server's when it was last used, to a second; null: not told."""

    id: uuid.UUID
    name: str
    model: str | None
    app_version: str | None
    clock_skew_seconds: float | None
    last_used_at: datetime | None = Field(description="To five minutes.")
    enrolled_at: datetime
    revoked_at: datetime | None


class DeviceOut(PhoneOut):
    """A phone and whose it is."""

    participant: str


class DeviceList(BaseModel):
    """A page of phones, the last enrolled first."""

    items: list[DeviceOut]
    next: str | None


class PhoneProtocol(BaseModel):
    """What of a study's protocol concerns the phone."""

    code: str
    name: str
    marker: str | None
    expects_after_pair: bool
    after_window_minutes: int
    locale: str
    gives_feedback: bool
    day_starts: str
    version: int


class MeOut(BaseModel):
    """Who the phone is."""

    participant: str
    starts_on: date | None
    study: PhoneProtocol
    device: PhoneOut
