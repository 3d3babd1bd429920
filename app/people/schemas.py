"""HTTP schemas of studies, participants, phones and their enrolment."""

import uuid
from datetime import date, datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, SecretStr

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import (
    APP_VERSION,
    LOCALE,
    NEXT,
    PARTICIPANT,
    PHONE_MODEL,
    SANDBOX,
    STUDY,
    ParticipantCode,
)
from app.http.page_of import PageOf
from app.http.text_schemas import LocalDay, Number, Text, unless_named
from app.nutrition.intakes.energy_requirement import (
    HEIGHT_LIMITS_M,
    WEIGHT_LIMITS_KG,
    Activity,
    Trimester,
)
from app.nutrition.intakes.life_stage import Sex
from app.people.calibration_schemas import CameraIn
from app.people.double_review import DoubleReview
from app.people.models import Locale, LocationPolicy, WithdrawalPolicy

Code = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$",
        description="Letters, digits, - _",
    ),
]
DayStart = Annotated[
    str,
    Field(
        pattern=r"^(?:(?:0\d|1[01]):[0-5]\d|12:00)$",
        description="HH:MM, 00:00 to 12:00: an earlier meal belongs to the day before. Fixed once there is a meal.",
    ),
]

DOUBLE_REVIEW = (
    "Which items two reviewers decide without seeing each other (docs/review.md); null: none."
)
Label = Annotated[Text, Field(min_length=1, max_length=64)]
ARM = "The study's arm that they are in; null: none was set."
VISIT = "The visit that they are at; null: none was set."
EXCLUDED = "Why their data are left out of the analysis; null: they are not."
ClockTime = Annotated[str, Field(pattern=r"^(?:[01]\d|2[0-3]):[0-5]\d$")]
ReminderTimes = Annotated[
    list[ClockTime],
    Field(max_length=8, description="Local times of day, HH:MM, at most 8."),
]


class ProtocolIn(ClosedModel):
    """A study's protocol. A PATCH changes only the named fields."""

    marker: Text | None = Field(
        default=None,
        max_length=64,
        description="The board that participants are given, such as plain:9x7:11.",
    )
    camera: CameraIn | None = Field(
        default=None,
        description="Intrinsics for meals that neither their metadata nor their phone provides any for.",
    )
    expects_after_pair: bool = Field(
        default=False, description="Whether a second pair is taken after the meal."
    )
    after_window_minutes: int = Field(
        default=240,
        ge=5,
        le=2880,
        description="How long the after-meal pair is expected, in minutes.",
    )
    location_policy: LocationPolicy = Field(
        default="drop",
        description="What is kept of a meal's place. With `drop` earlier places are no longer shown, and exports with "
        "them expire; frozen releases keep them.",
    )
    location_decimals: int | None = Field(
        default=None,
        ge=0,
        le=4,
        description="Decimals of a degree, with `round` only: 2 are about a kilometre.",
    )
    retention_days: int | None = Field(
        default=None,
        ge=1,
        le=36_500,
        description="Photographs are deleted so many days after upload; null: never.",
    )
    withdrawal_policy: WithdrawalPolicy = Field(
        default="erase", description="What happens to the data of a participant who leaves."
    )
    locale: Locale = Field(default="en", description="The participants' language.")
    gives_feedback: bool = Field(
        default=False,
        description="Whether participants see what they ate; it changes what people eat.",
    )
    day_starts: DayStart = "00:00"
    shares_index: bool = Field(
        default=False,
        description="Whether all studies of this server learn from its confirmed items: features of a food's "
        "appearance, the food and its volume; never photographs or personal data.",
    )
    identifies_by_context: bool = Field(
        default=True,
        description="Whether sizes and habits help to identify foods, beside their looks.",
    )
    web_origins: list[Annotated[Text, Field(max_length=300)]] = Field(
        default=[],
        max_length=20,
        description="Origins of web apps that participants may use, such as https://app.example.org.",
    )
    reminder_times: ReminderTimes = Field(
        default=[],
        description="Local times, HH:MM, at which phones that want it are reminded of their meals.",
    )
    double_review: DoubleReview | None = Field(default=None, description=DOUBLE_REVIEW)


class StudyIn(ProtocolIn):
    """A new study."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"code": "pilot", "name": "Pilot study", "marker": "plain:9x7:11"}
        },
    )

    code: Code
    name: Text = Field(min_length=1, max_length=200, description="The study's name, for people.")
    sandbox: bool = Field(
        default=False,
        description="Whether it is for authors of apps to try, never for real participants; it cannot be changed.",
    )


class StudyPatch(ProtocolIn):
    """A change of a study's named fields."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"location_policy": "round", "location_decimals": 2, "gives_feedback": True}
        },
    )

    name: Text = Field(
        default="",
        min_length=1,
        max_length=200,
        json_schema_extra=unless_named,
        description="The study's name, for people.",
    )


class StudyOut(BaseModel):
    """A study and its protocol."""

    code: str = Field(description=STUDY)
    name: str = Field(description="The study's name, for people.")
    marker: str | None = Field(
        description="The board that participants are given, such as plain:9x7:11; null: each meal must name its own."
    )
    camera: CameraIn | None = Field(
        description="Intrinsics for meals that neither their metadata nor their phone provides any for; null: none."
    )
    expects_after_pair: bool = Field(description="Whether a second pair is taken after the meal.")
    after_window_minutes: int = Field(
        description="How long the after-meal pair is waited for, from when the meal was eaten."
    )
    location_policy: LocationPolicy = Field(
        description="What is kept of a meal's place: nothing (drop), a rounded place (round), or the place (keep)."
    )
    location_decimals: int | None = Field(
        description="Decimals of a degree that are kept with `round`; null with another policy."
    )
    retention_days: int | None = Field(
        description="Photographs are deleted so many days after upload; null: never."
    )
    withdrawal_policy: WithdrawalPolicy = Field(
        description="What happens to the data of a participant who leaves."
    )
    locale: Locale = Field(description=LOCALE)
    gives_feedback: bool = Field(description="Whether participants see what they ate.")
    day_starts: str = Field(description="HH:MM: a meal before it belongs to the day before.")
    shares_index: bool = Field(
        description="Whether all studies of this server learn from its confirmed items (figures only, no photographs)."
    )
    identifies_by_context: bool = Field(
        description="Whether sizes and habits help to identify foods, beside their looks."
    )
    web_origins: list[str] = Field(
        description="Origins of web apps that participants may use, beside those of the server's setting."
    )
    reminder_times: list[str] = Field(
        description="Local times, HH:MM, at which phones are reminded."
    )
    double_review: DoubleReview | None = Field(description=DOUBLE_REVIEW)
    sandbox: bool = Field(description=SANDBOX)
    version: int = Field(description="Grows with every change of the study; the ETag names it.")
    created_at: datetime = Field(description="When the study was created.")


class StudyList(PageOf[StudyOut]):
    """A page of studies."""

    next: str | None = Field(default=None, description=NEXT)


class ProfileIn(ClosedModel):
    """What reference intakes and plausibility depend on; all fields are optional."""

    sex: Sex | None = Field(
        default=None, description="Sex by which reference intakes are chosen; null: unknown."
    )
    birth_year: int | None = Field(
        default=None, ge=1900, le=2200, description="Year of birth; null: unknown."
    )
    height_cm: Number | None = Field(
        default=None,
        ge=100 * HEIGHT_LIMITS_M[0],
        le=100 * HEIGHT_LIMITS_M[1],
        description="Body height; null: unknown.",
    )
    weight_kg: Number | None = Field(
        default=None,
        ge=WEIGHT_LIMITS_KG[0],
        le=WEIGHT_LIMITS_KG[1],
        description="In pregnancy, the weight before it.",
    )
    activity: Activity | None = Field(
        default=None, description="Physical activity level; null: unknown."
    )
    is_pregnant: bool | None = Field(default=None, description="Whether pregnant; null: unknown.")
    trimester: Trimester | None = Field(
        default=None, description="Trimester of the pregnancy; null: unknown, or not pregnant."
    )
    is_lactating: bool | None = Field(
        default=None, description="Whether breastfeeding; null: unknown."
    )
    lactation_months: int | None = Field(
        default=None, ge=0, le=60, description="Completed months since birth."
    )


class ParticipantFields(BaseModel):
    """Labels of a participant that staff set beside the profile."""

    starts_on: LocalDay | None = Field(
        default=None, description="Local day that is day 1; null: that of the first meal."
    )
    arm: Label | None = Field(default=None, description=ARM)
    visit: Label | None = Field(default=None, description=VISIT)
    excluded: Text | None = Field(default=None, min_length=1, max_length=200, description=EXCLUDED)


class ParticipantIn(ParticipantFields):
    """A new participant, by a code that says nothing about the person."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"code": "P001"}})

    code: Code
    profile: ProfileIn = Field(
        default_factory=ProfileIn, description="The person's profile; empty by default."
    )


class ParticipantPatch(ParticipantFields):
    """A change of a participant's named fields. null removes one, also of the profile."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"profile": {"sex": "female", "birth_year": 1990}}},
    )

    profile: ProfileIn = Field(default_factory=ProfileIn, description="Only the named keys change.")


class ParticipantRow(BaseModel):
    """A participant in a list."""

    code: str = Field(description=PARTICIPANT)
    starts_on: date | None = Field(
        description="Local day that is day 1; null: that of the first meal."
    )
    arm: str | None = Field(description=ARM)
    visit: str | None = Field(description=VISIT)
    excluded: str | None = Field(description=EXCLUDED)
    withdrawn_at: datetime | None = Field(
        description="When they left the study; null: they are in it."
    )
    created_at: datetime = Field(description="When the participant was created.")


class ParticipantOut(ParticipantRow):
    """A participant with their profile."""

    profile: ProfileIn = Field(description="The person's profile.")


class ParticipantList(PageOf[ParticipantRow]):
    """A page of participants."""


class EnrolmentCodeOut(BaseModel):
    """A one-time code for a participant's next device, shown once."""

    code: str = Field(description="The one-time code, to be typed in.")
    expires_at: datetime = Field(description="Until when it can be used.")
    qr_text: str = Field(description="The text of the QR code: JSON with server and code.")
    qr_svg: str = Field(description="The QR code as SVG, to embed in a page.")
    capture_url: str = Field(
        description="The link that enrols a phone's browser in the capture page."
    )


class EnrolmentIn(ClosedModel):
    """A device exchanges its code for a token."""

    code: Text = Field(
        min_length=1,
        max_length=100,
        description="The one-time code that the participant was given.",
    )
    device_name: Text = Field(
        min_length=1, max_length=200, description="Such as the phone's model."
    )
    model: Text | None = Field(
        default=None, min_length=1, max_length=200, description="The phone's model."
    )
    app_version: Text | None = Field(
        default=None, min_length=1, max_length=64, description="The version of the phone's app."
    )
    secret: SecretStr | None = Field(
        default=None,
        min_length=22,
        max_length=100,
        description="At least 128 random bits as text, drawn and kept by the phone before the call: if the answer is "
        "lost, the same call gets the same token.",
    )


class EnrolmentOut(BaseModel):
    """The device's token."""

    token: str = Field(
        description="Send it as `Authorization: Bearer TOKEN`. Keep it safe: only the same call with the same `secret` "
        "gives it again."
    )
    device_id: uuid.UUID = Field(description="The phone's id.")
    study: str = Field(description=STUDY)
    participant: ParticipantCode
    marker: str | None = Field(
        description="The board that the study gives out, such as plain:9x7:11; null: none."
    )


class PhoneOut(BaseModel):
    """A phone. clock_skew_seconds is accurate to a second."""

    id: uuid.UUID = Field(description="The phone's id.")
    name: str = Field(description="The name that it was enrolled with.")
    model: str | None = Field(description=PHONE_MODEL)
    app_version: str | None = Field(description=APP_VERSION)
    clock_skew_seconds: float | None = Field(
        description="The phone's clock minus the server's when it was last used; null: unknown."
    )
    last_used_at: datetime | None = Field(
        description="When it was last used, accurate to five minutes."
    )
    enrolled_at: datetime = Field(description="When it was enrolled.")
    revoked_at: datetime | None = Field(description="When its token was ended; null: it is valid.")


class DeviceOut(PhoneOut):
    """A phone and its participant."""

    participant: ParticipantCode


class DeviceList(PageOf[DeviceOut]):
    """A page of phones, the last enrolled first."""


class PhoneProtocol(BaseModel):
    """The part of a study's protocol that concerns the phone."""

    code: str = Field(description=STUDY)
    name: str = Field(description="The study's name, for people.")
    marker: str | None = Field(
        description="The board that participants are given, such as plain:9x7:11; null: each meal must name its own."
    )
    expects_after_pair: bool = Field(description="Whether a second pair is taken after the meal.")
    after_window_minutes: int = Field(
        description="How long the after-meal pair is waited for, from when the meal was eaten."
    )
    locale: Locale = Field(description=LOCALE)
    gives_feedback: bool = Field(
        description="Whether the participant may see what they ate (GET /v1/me/summary)."
    )
    location_policy: LocationPolicy = Field(description="What is kept of a meal's place.")
    retention_days: int | None = Field(
        description="Photographs are deleted so many days after upload; null: never."
    )
    withdrawal_policy: WithdrawalPolicy = Field(
        description="What happens to the data of a participant who leaves."
    )
    day_starts: str = Field(description="HH:MM: a meal before it belongs to the day before.")
    sandbox: bool = Field(description=SANDBOX)
    version: int = Field(description="Grows with every change of the study.")


class MeOut(BaseModel):
    """The phone, its participant and study."""

    participant: ParticipantCode
    starts_on: date | None = Field(
        description="Local day that is day 1; null: that of the first meal."
    )
    joined_at: datetime = Field(description="When the participant's first phone was enrolled.")
    study: PhoneProtocol = Field(
        description="The part of the study's protocol that concerns the phone."
    )
    device: PhoneOut = Field(description="This phone.")
