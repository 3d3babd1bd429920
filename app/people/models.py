"""Studies and their protocol, participants, their devices and cameras, staff, roles, tokens."""

import uuid
from datetime import date, datetime
from typing import Any, Literal, TypedDict, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonValue, Personal, one_of
from app.db.columns import (
    BigInt,
    DeviceRef,
    ParticipantRef,
    StaffRef,
    Str16,
    Str64,
    Str100,
    Str200,
    Str500,
    StudyRef,
    UuidKey,
    Version,
)
from app.people.profiles import Profile

LocationPolicy = Literal["drop", "round", "keep"]
LOCATION_POLICIES: tuple[LocationPolicy, ...] = get_args(LocationPolicy)
# each does all that the one before it does
WithdrawalPolicy = Literal["keep", "anonymise", "erase"]
WITHDRAWAL_POLICIES: tuple[WithdrawalPolicy, ...] = get_args(WithdrawalPolicy)
Locale = Literal["en", "de", "es", "zh"]
LOCALES: tuple[Locale, ...] = get_args(Locale)
Role = Literal["viewer", "reviewer", "owner"]  # each includes the rights of the one before it
ROLES: tuple[Role, ...] = get_args(Role)
TOKEN_KINDS = ("device", "session", "personal")
Scope = Literal["read", "write"]
SCOPES: tuple[Scope, ...] = get_args(Scope)


class PinholeDetails(TypedDict):
    """Intrinsics of a camera for upright pixels, px."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


class CameraDetails(PinholeDetails):
    """A phone's camera. distortion: k1, k2, p1, p2, k3."""

    distortion: list[float]


class RigDetails(TypedDict):
    """Two cameras that are fixed to each other: x_right = R x_left + t_mm."""

    left: CameraDetails
    right: CameraDetails
    R: list[list[float]]
    t_mm: list[float]


class CameraCalibration(Base):
    """A calibration; of each kind a phone uses its newest one that is not withdrawn.

    rig: of the kind "rig"; camera is then its left one. device_id: NULL if staff sent it for the
    phones of study_id, all of them or those of a model. rms_px: reprojection error of the board's
    corners. photographs: number used.
    """

    __tablename__ = "camera_calibration"
    personal = Personal(("device_id",), "camera_calibrations")

    id: Mapped[UuidKey]
    device_id: Mapped[DeviceRef | None] = mapped_column(index=True)
    study_id: Mapped[StudyRef | None] = mapped_column(index=True)
    model: Mapped[Str200 | None] = mapped_column(index=True)
    marker: Mapped[Str64 | None]
    camera: Mapped[CameraDetails] = mapped_column(JsonValue)
    rig: Mapped[RigDetails | None] = mapped_column(JsonValue)
    rms_px: Mapped[float | None]
    photographs: Mapped[int | None]
    author: Mapped[Str200]
    created_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]


class Study(Base):
    """A study and its protocol.

    change_seq: counter of changes, locked until commit so that readers miss none.

    camera: intrinsics for meals whose metadata and device have none. after_window_minutes: how long
    an after-meal pair is expected after the meal began. day_starts_minutes: after midnight; an
    earlier meal belongs to the day before. retention_days: photographs and derived pictures are
    deleted so many days after upload; NULL: they stay. shares_index: this study's confirmed items
    also help to identify foods of other studies. identifies_by_context: sizes and habits count beside
    looks. web_origins: of web apps that its participants may
    use; NULL: none of its own. reminder_times: "HH:MM", local; NULL: none. is_sandbox: for authors
    of apps, never for real participants (docs/sandbox.md); it never changes. double_review: the
    fields of people/double_review.py; NULL: no item is decided twice. version grows with every
    change of the protocol.
    """

    __tablename__ = "study"

    id: Mapped[UuidKey]
    code: Mapped[Str64] = mapped_column(unique=True)
    name: Mapped[Str200]
    # the board that its participants were given
    marker: Mapped[Str64 | None]
    camera: Mapped[CameraDetails | None] = mapped_column(JsonValue)
    expects_after_pair: Mapped[bool] = mapped_column(default=False)
    after_window_minutes: Mapped[int] = mapped_column(default=240)
    location_policy: Mapped[LocationPolicy] = mapped_column(sa.String(16), default="drop")
    location_decimals: Mapped[int | None]  # of degrees; set with "round" only
    retention_days: Mapped[int | None]
    withdrawal_policy: Mapped[WithdrawalPolicy] = mapped_column(sa.String(16), default="erase")
    locale: Mapped[Locale] = mapped_column(sa.String(8), default="en")
    gives_feedback: Mapped[bool] = mapped_column(default=False)
    day_starts_minutes: Mapped[int] = mapped_column(default=0)
    shares_index: Mapped[bool] = mapped_column(default=False)
    identifies_by_context: Mapped[bool] = mapped_column(default=True, server_default=sa.true())
    web_origins: Mapped[list[str] | None]
    reminder_times: Mapped[list[str] | None]
    is_sandbox: Mapped[bool] = mapped_column(default=False, server_default=sa.false())
    double_review: Mapped[dict[str, Any] | None]
    version: Mapped[Version]
    change_seq: Mapped[BigInt] = mapped_column(default=0)
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("location_policy", LOCATION_POLICIES),
        one_of("withdrawal_policy", WITHDRAWAL_POLICIES),
        one_of("locale", LOCALES),
        sa.CheckConstraint(
            "(location_policy = 'round') = (location_decimals IS NOT NULL)",
            name="decimals_to_round",
        ),
    )


class Participant(Base):
    """A person in a study, by pseudonymous code only.

    alias: the participant's name in the audit log; only this row connects it to a person.
    starts_on: local day that is the participant's study day 1; NULL: the day of the first meal.
    arm, visit: the study's own labels. excluded: why their data are left out of the analysis; NULL:
    they are not.
    profile: NULL if nothing is known. favourites: named lists of foods and amounts, as FavouriteIn.
    """

    __tablename__ = "participant"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    code: Mapped[Str64]
    alias: Mapped[uuid.UUID] = mapped_column(unique=True, default=uuid.uuid4)
    starts_on: Mapped[date | None]
    arm: Mapped[Str64 | None]
    visit: Mapped[Str64 | None]
    excluded: Mapped[Str200 | None]
    profile: Mapped[Profile | None] = mapped_column(JsonValue)
    favourites: Mapped[list[dict[str, object]] | None] = mapped_column(JsonValue)
    withdrawn_at: Mapped[datetime | None]
    created_at: Mapped[datetime]

    __table_args__ = (sa.UniqueConstraint("study_id", "code"),)


class Device(Base):
    """A phone of a participant.

    clock_skew_seconds: its clock minus the server's, at last_used_at.
    """

    __tablename__ = "device"
    personal = Personal(("participant_id",), "devices")

    id: Mapped[UuidKey]
    participant_id: Mapped[ParticipantRef] = mapped_column(index=True)
    name: Mapped[Str200]
    model: Mapped[Str200 | None]
    app_version: Mapped[Str64 | None]
    clock_skew_seconds: Mapped[float | None]
    last_used_at: Mapped[datetime | None]
    enrolled_at: Mapped[datetime]
    revoked_at: Mapped[datetime | None]


class Staff(Base):
    """A person who runs the server or works with the data.

    password_hash: Argon2; NULL: can use tokens only. totp_secret: sealed; NULL: signing in with the
    password needs no code. totp_step: the last time step whose code was used; totp_wrong_step:
    the last one in which a wrong code was entered. oidc_identity: SHA-256
    of the person's issuer and subject (people/access/oidc.py).
    """

    __tablename__ = "staff"

    id: Mapped[UuidKey]
    name: Mapped[Str200] = mapped_column(unique=True)
    is_admin: Mapped[bool]
    password_hash: Mapped[Str200 | None]
    totp_secret: Mapped[Str200 | None]
    totp_step: Mapped[BigInt | None]
    totp_wrong_step: Mapped[BigInt | None]
    oidc_identity: Mapped[Str64 | None] = mapped_column(unique=True, index=True)
    disabled_at: Mapped[datetime | None]
    created_at: Mapped[datetime]

    @property
    def has_password(self) -> bool:
        """Whether the staff member can sign in with a password."""
        return self.password_hash is not None

    @property
    def has_totp(self) -> bool:
        """Return whether signing in with the password needs a code of an app, too."""
        return self.totp_secret is not None


class StudyMember(Base):
    """A staff member's role in a study."""

    __tablename__ = "study_member"

    study_id: Mapped[StudyRef] = mapped_column(primary_key=True)
    staff_id: Mapped[StaffRef] = mapped_column(primary_key=True, index=True)
    role: Mapped[Role] = mapped_column(sa.String(16))
    created_at: Mapped[datetime]

    __table_args__ = (one_of("role", ROLES),)


class Enrolment(Base):
    """A one-time code that a device exchanges for its token; only the code's SHA-256 is stored."""

    __tablename__ = "enrolment"
    personal = Personal(("participant_id",), "enrolments")

    id: Mapped[UuidKey]
    participant_id: Mapped[ParticipantRef] = mapped_column(index=True)
    code_sha256: Mapped[Str64] = mapped_column(unique=True)
    expires_at: Mapped[datetime]
    used_at: Mapped[datetime | None]
    created_at: Mapped[datetime]


class AccessToken(Base):
    """An opaque bearer token of a device or of a staff member; only its SHA-256 is stored.

    kind: of a device, of a session, or created by a staff member for scripts. scope and study_id
    restrict a personal token to reading or to one study.
    """

    __tablename__ = "access_token"
    personal = Personal(("device_id",))

    id: Mapped[UuidKey]
    token_sha256: Mapped[Str64] = mapped_column(unique=True)
    kind: Mapped[Str16]
    name: Mapped[Str200 | None]
    scope: Mapped[Scope] = mapped_column(sa.String(16), default="write")
    study_id: Mapped[StudyRef | None]
    device_id: Mapped[DeviceRef | None] = mapped_column(index=True)
    staff_id: Mapped[StaffRef | None] = mapped_column(index=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("kind", TOKEN_KINDS),
        one_of("scope", SCOPES),
        sa.CheckConstraint("(device_id IS NULL) <> (staff_id IS NULL)", name="one_owner"),
    )


class SignInAttempt(Base):
    """A try to sign in, for limits that all processes count together (people/access/sign_in.py).

    name_digest, address_digest: HMACs, which only this server can compute.
    """

    __tablename__ = "sign_in_attempt"

    id: Mapped[UuidKey]
    name_digest: Mapped[Str64]
    address_digest: Mapped[Str64]
    attempted_at: Mapped[datetime]
    is_success: Mapped[bool] = mapped_column(default=False, server_default=sa.false())

    __table_args__ = (
        sa.Index("ix_sign_in_attempt_name", "name_digest", "attempted_at"),
        sa.Index("ix_sign_in_attempt_address", "address_digest", "attempted_at"),
    )


class PushSubscription(Base):
    """Where and when a phone is reminded.

    endpoint: of the browser's push service, an address that the phone gave.

    times: the participant's own, "HH:MM"; NULL: the study's. quiet_*: no reminder of the study's
    between them, minutes after midnight; both equal: never quiet. next_at: the next reminder; NULL:
    no times, or to be computed. after_reminded_at: the end of the last after-meal window of which
    the phone was reminded.
    """

    __tablename__ = "push_subscription"
    personal = Personal(("device_id",), "reminders")

    # with CASCADE, an older server that knows no subscriptions can still erase a phone
    device_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("device.id", ondelete="CASCADE"), primary_key=True
    )
    endpoint: Mapped[Str500]
    public_key: Mapped[Str100]
    auth: Mapped[str] = mapped_column(sa.String(40))
    times: Mapped[list[str] | None]
    after_meal: Mapped[bool]
    time_zone: Mapped[Str64]
    quiet_from_minutes: Mapped[int]
    quiet_until_minutes: Mapped[int]
    next_at: Mapped[datetime | None] = mapped_column(index=True)
    after_reminded_at: Mapped[datetime | None]
    created_at: Mapped[datetime]
