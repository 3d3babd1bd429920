"""Meals and their photographs, as they arrived."""

import uuid
from dataclasses import dataclass
from datetime import date, datetime
from typing import Literal, NotRequired, TypedDict, cast, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.core.errors import Failure
from app.db.base import Base, BlobColumns, JsonValue, Personal, index_where, one_of
from app.db.columns import (
    BigInt,
    DeviceRef,
    LongStr,
    MealRef,
    ParticipantRef,
    Str16,
    Str32,
    Str64,
    Str200,
    StudyRef,
    UuidKey,
    Version,
)
from app.meals.stored.outline_json import Polygon
from app.people.models import CameraDetails, PinholeDetails, RigDetails
from app.photos.slots import AFTER_SLOTS, SLOTS, VIEW_SLOTS

MealStatus = Literal[
    "receiving", "queued", "processing", "estimated", "needs_review", "failed", "confirmed"
]
MEAL_STATUSES: tuple[MealStatus, ...] = get_args(MealStatus)
MealOrigin = Literal["photographed", "declared"]
MEAL_ORIGINS: tuple[MealOrigin, ...] = get_args(MealOrigin)
AfterStatus = Literal[
    "receiving", "queued", "processing", "estimated", "needs_review", "failed", "nothing_left"
]
AFTER_STATUSES: tuple[AfterStatus, ...] = get_args(AfterStatus)
DEFAULT_VIEWS = 2


# `class` is a keyword, so these two use the functional form
PieceDetails = TypedDict(
    "PieceDetails",
    {
        "id": str,
        "item": str | None,
        "class": str,
        "is_by_person": bool,
        "polygon": Polygon,
        "food": dict[str, str] | None,
        "volume_ml": float | None,
        "volume_interval_ml": list[float] | None,
        "mass_g": float | None,
        "mass_interval_g": list[float] | None,
        "flags": list[str],
    },
)
HintDetails = TypedDict(
    "HintDetails",
    {
        "point": list[float],
        "box": list[float],
        "polygon": Polygon,
        "food": str,
        "lies_as": str,
        "form": str,
        "vessel": str,
        "item": str,
        "class": str,
    },
    total=False,
)


class AsideDetails(TypedDict, total=False):
    """Metadata fields that this version does not know.

    ignored: their places; unknown: the fields, as JSON text
    """

    ignored: list[str]
    unknown: str


class PosesDetails(TypedDict):
    """Camera poses as sent: 4 x 4 by view, camera to world, m."""

    convention: str
    views: dict[str, list[list[float]]]
    gravity: list[float] | None


class PairDetails(AsideDetails):
    """The metadata of a pair of photographs as accepted.

    complete: the hints are all that there is.
    """

    captured_at: str
    time_zone: str
    camera: CameraDetails | None
    hints: list[HintDetails]
    complete: NotRequired[bool]
    poses: NotRequired[PosesDetails]


class DeclaredItemDetails(TypedDict):
    """A food of a meal without photographs, as its phone sent it."""

    food: str
    amount: dict[str, float | str | None] | None
    share: float


class DepthCameraDetails(PinholeDetails):
    """A depth camera, px of its map; unit_mm: of whole numbers in a PNG."""

    unit_mm: float


class MealDetails(PairDetails):
    """The metadata of a meal as accepted.

    declared: the foods of a meal without photographs
    views: if not 2
    rig: if it was sent
    wanted_outcome: how its estimate is to end, if asked for
    depth_camera, depth_maps: of a meal with depth maps; their slots
    """

    marker: str | None
    location: dict[str, float] | None
    app_version: str | None
    declared: NotRequired[list[DeclaredItemDetails]]
    views: NotRequired[int]
    rig: NotRequired[RigDetails]
    wanted_outcome: NotRequired[str]
    depth_camera: NotRequired[DepthCameraDetails]
    depth_maps: NotRequired[list[str]]


class Meal(Base):
    """One eating occasion. Its status decides what happens next; `version` grows with every change.

    client_id: the UUID that the phone made, unique for the participant; id is internal and never
        leaves the server
    captured_at: the instant; local_date: the day in time_zone
    alias: its name in the audit log. origin "declared": entered without photographs. after_*: the
        state of its after-meal pair, which never changes the meal's own status.
    after_due_at: until then its records are provisional; NULL: no pair is expected
    leftovers: the pieces of the after-meal pair as the API shows them, a projection like the
        records
    """

    __tablename__ = "meal"

    id: Mapped[UuidKey]
    client_id: Mapped[uuid.UUID]
    study_id: Mapped[StudyRef]
    participant_id: Mapped[ParticipantRef]
    device_id: Mapped[DeviceRef] = mapped_column(index=True)
    alias: Mapped[uuid.UUID] = mapped_column(unique=True, default=uuid.uuid4)
    origin: Mapped[MealOrigin] = mapped_column(sa.String(16), default="photographed")
    captured_at: Mapped[datetime]
    utc_offset_minutes: Mapped[int]
    time_zone: Mapped[Str64]
    local_date: Mapped[date]
    details: Mapped[MealDetails] = mapped_column(JsonValue)
    status: Mapped[MealStatus] = mapped_column(sa.String(16))
    stage: Mapped[Str32 | None]
    failure_code: Mapped[Str64 | None]
    failure_message: Mapped[LongStr | None]
    failure_advice: Mapped[LongStr | None]
    after_status: Mapped[AfterStatus | None] = mapped_column(sa.String(16), index=True)
    after_details: Mapped[PairDetails | None] = mapped_column(JsonValue)
    after_failure_code: Mapped[Str64 | None]
    after_failure_message: Mapped[LongStr | None]
    after_failure_advice: Mapped[LongStr | None]
    after_due_at: Mapped[datetime | None] = mapped_column(index=True)
    leftovers: Mapped[list[PieceDetails]] = mapped_column(JsonValue, default=list, deferred=True)
    version: Mapped[Version]
    received_at: Mapped[datetime]
    submitted_at: Mapped[datetime | None]

    __table_args__ = (
        sa.UniqueConstraint("participant_id", "client_id"),
        one_of("status", MEAL_STATUSES),
        one_of("origin", MEAL_ORIGINS),
        one_of("after_status", AFTER_STATUSES),
        sa.Index(None, "study_id", "captured_at", "id"),
        sa.Index(None, "participant_id", "local_date"),
        sa.Index(None, "study_id", "local_date", "participant_id"),
        sa.Index(None, "status", "submitted_at"),
        # lists of meals (meal_page_queries.py): each covers the page's order and the filter on days
        sa.Index(
            "ix_meal_list_of_status",
            "study_id",
            "status",
            "origin",
            "captured_at",
            "id",
            "local_date",
        ),
        sa.Index(
            "ix_meal_list_of_participant", "participant_id", "captured_at", "id", "local_date"
        ),
        index_where(
            "ix_meal_list_of_failure",
            *("study_id", "failure_code", "captured_at", "id", "local_date"),
            where="failure_code IS NOT NULL",
        ),
        index_where(
            "ix_meal_list_of_after",
            *("study_id", "after_status", "captured_at", "id", "local_date"),
            where="after_status IS NOT NULL",
        ),
        sa.Index(None, "client_id"),
    )

    def pair(self, purpose: str) -> "Pair":
        """Return the meal's own pair, or for "after" its after-meal pair."""
        return Pair(self, "after_" if purpose == "after" else "")

    @property
    def view_slots(self) -> tuple[str, ...]:
        """The slots of the photographs that show the meal."""
        return VIEW_SLOTS[: self.details.get("views", DEFAULT_VIEWS)]

    @property
    def map_slots(self) -> tuple[str, ...]:
        """The slots of its depth and confidence maps."""
        return tuple(self.details.get("depth_maps", ()))

    @property
    def announced_slots(self) -> tuple[str, ...]:
        """The slots of the photographs and maps that make the meal complete."""
        return announced_slots(self.details)


@dataclass(frozen=True, slots=True)
class Pair:
    """A pair of photographs, with its state in the meal's columns.

    prefix: of the columns' names: "" for the meal's own pair
    """

    meal: Meal
    prefix: Literal["", "after_"]

    @property
    def status(self) -> str | None:
        """The pair's status; None: no after-meal pair has come."""
        return cast("str | None", getattr(self.meal, f"{self.prefix}status"))

    @property
    def failure_code(self) -> str | None:
        """Why it failed; None: it did not."""
        return cast("str | None", getattr(self.meal, f"{self.prefix}failure_code"))

    @property
    def slots(self) -> tuple[str, ...]:
        """The slots of the photographs and maps that it needs."""
        return AFTER_SLOTS if self.prefix else self.meal.announced_slots

    def set_status(self, status: str) -> None:
        """Set the status; the meal's own is then at no stage."""
        setattr(self.meal, f"{self.prefix}status", status)
        if not self.prefix:
            self.meal.stage = None

    def set_failure(self, failure: Failure | None) -> None:
        """Set why it failed; None: it did not."""
        for name in ("code", "message", "advice"):
            setattr(self.meal, f"{self.prefix}failure_{name}", getattr(failure, name, None))


def announced_slots(details: MealDetails) -> tuple[str, ...]:
    """The slots that a meal's metadata announce, in order."""
    return (*VIEW_SLOTS[: details.get("views", DEFAULT_VIEWS)], *details.get("depth_maps", ()))


REENCODED = "reencoded"  # a photograph's flag


class MealImage(Base):
    """One photograph, map or voice note, which has a width and height of 0.

    received_sha256: as the phone sent it; stored_sha256: as sealed, perhaps without location
    decoding_pixels: of a baseline JPEG that takes as long to decode; None: of a map or a voice
    note.

    is_reencoded: its location could only be cut by writing its picture anew.
    erased_at: when retention or a withdrawal erased it; its blob is deleted or about to be.
    """

    __tablename__ = "meal_image"
    personal = Personal(("meal_id",), "photographs")
    blob = BlobColumns(erased_at="erased_at")

    id: Mapped[UuidKey]
    meal_id: Mapped[MealRef]
    slot: Mapped[Str16]
    media_type: Mapped[Str32]
    width_px: Mapped[int]
    height_px: Mapped[int]
    bytes: Mapped[BigInt]
    received_sha256: Mapped[Str64]
    stored_sha256: Mapped[Str64]
    blob_key: Mapped[Str200] = mapped_column(unique=True)
    decoding_pixels: Mapped[BigInt | None]
    is_reencoded: Mapped[bool] = mapped_column(default=False, server_default=sa.false())
    received_at: Mapped[datetime]
    erased_at: Mapped[datetime | None]

    @property
    def flags(self) -> list[str]:
        """Causes of doubt about the photograph (docs/flags.md)."""
        return [REENCODED] if self.is_reencoded else []

    __table_args__ = (sa.UniqueConstraint("meal_id", "slot"), one_of("slot", SLOTS))
