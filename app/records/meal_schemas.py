"""A meal over the wire."""

import uuid
from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, computed_field, model_validator

from app.foods.schemas import FoodRef, NutrientAmount, NutrientTotal
from app.http.closed_model import ClosedModel
from app.http.field_descriptions import (
    FLAGS,
    FOOD,
    MEAL_ID,
    MEAL_VERSION,
    RECEIVED_AT,
    STUDY,
    TIME_ZONE,
    CapturedAt,
    Interval,
    LocalDate,
    ParticipantCode,
)
from app.http.text_schemas import Instant, JsonNumber, Text
from app.meals.stored.models import DEFAULT_VIEWS, AfterStatus, MealStatus
from app.meals.stored.record_models import CandidateSource, ItemOrigin, LeftoverClass, RecordStatus
from app.messages.catalogue import sentence
from app.nutrition.foods import DensityBasis, FoodForm
from app.people.calibration_schemas import CameraIn, RigIn
from app.people.models import LOCALES
from app.photos.slots import (
    DEPTH_SLOTS,
    PAIR_SLOTS,
    VIEW_SLOTS,
    DepthSlot,
    confidence_slot,
    depth_slot,
)
from app.records.schemas import PlaceIn
from app.vision.photograph.depth_camera import DEFAULT_UNIT_MM

MAX_HINTS = 20


class HintIn(PlaceIn):
    """Where a food is in the left photograph, upright pixels, and what it is. One of point, box, polygon, or none."""

    food: Text | None = Field(
        default=None, min_length=1, max_length=100, description="A food's key (GET /v1/foods)."
    )
    lies_as: FoodForm | None = Field(
        default=None,
        description="How it lies there, where that is not as it usually does: an apple cut into slices is a `heap`.",
    )
    form: FoodForm | None = Field(
        default=None,
        description="How it lies there, for measuring alone; `lies_as` also says which density counts.",
    )
    vessel: Text | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="The name of the study's vessel that holds it (GET /v1/me/vessels).",
    )

    @model_validator(mode="after")
    def _one_place(self) -> "HintIn":
        given = [name for name in ("point", "box", "polygon") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"give one of point, box and polygon, not {' and '.join(given)}")
        if not given and self.food is None:
            raise ValueError("give a point, a box, a polygon or a food")
        if self.box is not None and (self.box[2] <= 0 or self.box[3] <= 0):
            raise ValueError("a box needs a positive width and height")
        return self


class LocationIn(ClosedModel):
    """Where the meal was, WGS84. Kept only if the study keeps locations."""

    latitude: JsonNumber = Field(ge=-90, le=90, description="Degrees north, WGS84.")
    longitude: JsonNumber = Field(ge=-180, le=180, description="Degrees east, WGS84.")
    accuracy_m: JsonNumber | None = Field(
        default=None,
        ge=0,
        description="Radius within which the phone believes to be, m; null: not known.",
    )


class DepthCameraIn(ClosedModel):
    """Intrinsics of the depth maps: a pinhole in the pose of the photograph, for upright maps."""

    width: int = Field(gt=0, le=100_000, strict=True, description="Width of the maps, px.")
    height: int = Field(gt=0, le=100_000, strict=True, description="Height of the maps, px.")
    fx: JsonNumber = Field(gt=0, description="Focal length across, px of the map.")
    fy: JsonNumber = Field(gt=0, description="Focal length down, px of the map.")
    cx: JsonNumber = Field(description="Principal point from the left edge, px.")
    cy: JsonNumber = Field(description="Principal point from the upper edge, px.")
    unit_mm: JsonNumber = Field(
        default=DEFAULT_UNIT_MM, gt=0, description="Unit of a PNG's whole numbers, mm."
    )


PoseRow = tuple[JsonNumber, JsonNumber, JsonNumber, JsonNumber]
PoseIn = tuple[PoseRow, PoseRow, PoseRow, PoseRow]


class PairPosesIn(ClosedModel):
    """4 x 4, row by row, from the camera's axes to the world's, m."""

    left: PoseIn = Field(description="Of the left photograph.")
    right: PoseIn = Field(description="Of the right photograph.")


class PosesIn(ClosedModel):
    """Camera poses that the phone's tracking gave at the moment of each photograph (docs/apps.md)."""

    convention: Literal["arkit", "arcore", "opencv"] = Field(
        description="The camera's axes. arkit (ARCamera.transform) and arcore (Camera.getPose): x right, y up, "
        "z backwards in the picture as stored, before EXIF turns it. opencv: x right, y down, z forwards in the "
        "upright picture."
    )
    views: PairPosesIn = Field(description="The poses, all in one world.")
    gravity: tuple[JsonNumber, JsonNumber, JsonNumber] | None = Field(
        default=None,
        description="Down, in the world's axes, of any length; null: minus y with arkit and arcore, else not known.",
    )


class MealMetadataIn(ClosedModel):
    """What the phone tells beside the photographs."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "captured_at": "2026-11-21T12:30:00+08:00",
                "time_zone": "Asia/Shanghai",
                "marker": "plain:9x7:11",
                "hints": [{"point": [812, 560], "food": "apple"}],
                "app_version": "1.4.0",
            }
        },
    )

    captured_at: Instant = Field(
        description="When the left photograph was taken: RFC 3339 with offset."
    )
    time_zone: Text = Field(
        min_length=1, max_length=64, description="IANA name, such as Asia/Shanghai."
    )
    marker: Text | None = Field(
        default=None,
        max_length=64,
        description="The board in the photographs, such as plain:9x7:11; default: the study's.",
    )
    camera: CameraIn | None = Field(
        default=None,
        description="Intrinsics of the phone's camera; null: the phone's calibration, else its model's, else the "
        "study's, else from EXIF.",
    )
    rig: RigIn | None = Field(
        default=None,
        description="The stereo rig that took left and right, in place of marker and camera; null: the phone's, else "
        "its model's, else the study's, if there is one and no marker is named here.",
    )
    poses: PosesIn | None = Field(
        default=None,
        description="Poses by ARKit or ARCore, which give the scale where no marker is seen; the camera's intrinsics "
        "must then be known.",
    )
    hints: list[HintIn] = Field(
        default_factory=list,
        max_length=MAX_HINTS,
        description="What the person knows of some of the foods; the others are looked for all the same.",
    )
    complete: bool = Field(
        default=False,
        strict=True,
        description="Whether the hints are all that there is: nothing else is looked for.",
    )
    views: int = Field(
        default=DEFAULT_VIEWS,
        ge=1,
        le=len(VIEW_SLOTS),
        strict=True,
        description="How many photographs show the meal: 1, the left one alone; 2, left and right; more, also view3 up "
        "to this number.",
    )
    depth_camera: DepthCameraIn | None = Field(
        default=None, description="Intrinsics of the depth maps; null: there are none."
    )
    depth_maps: list[DepthSlot] | None = Field(
        default=None,
        max_length=len(DEPTH_SLOTS),
        description="The slots of the depth and confidence maps that are sent beside the photographs; null: "
        "`left_depth` if there is a depth_camera, else none.",
    )
    location: LocationIn | None = Field(
        default=None,
        description="Where the meal was eaten; kept only if the study keeps locations.",
    )
    app_version: Text | None = Field(
        default=None, max_length=64, description="The version of the phone's app."
    )

    @model_validator(mode="after")
    def _rig_alone(self) -> "MealMetadataIn":
        if self.rig is not None and (self.marker is not None or self.camera is not None):
            raise ValueError("a rig has its own cameras and scale: leave marker and camera out")
        if self.rig is not None and self.views != len(PAIR_SLOTS):
            raise ValueError("a rig takes two photographs, left and right: leave views out")
        return self

    @property
    def announced_maps(self) -> list[str]:
        """The slots of the depth and confidence maps, in order."""
        chosen = ["left_depth"] if self.depth_maps is None else self.depth_maps
        return (
            [slot for slot in DEPTH_SLOTS if slot in chosen]
            if self.depth_camera is not None
            else []
        )

    @model_validator(mode="after")
    def _maps_of_views(self) -> "MealMetadataIn":
        if self.depth_maps and self.depth_camera is None:
            raise ValueError("depth_maps need a depth_camera")
        for number, view in enumerate(PAIR_SLOTS, start=1):
            has_depth, has_confidence = (
                slot(view) in self.announced_maps for slot in (depth_slot, confidence_slot)
            )
            if has_confidence and not has_depth:
                raise ValueError(f"{confidence_slot(view)} needs {depth_slot(view)}")
            if has_depth and self.views < number:
                raise ValueError(f"{depth_slot(view)} needs the photograph {view}")
        return self


class NewMealMetadataIn(MealMetadataIn):
    """The metadata part of POST /v1/meals: with the id that the phone made."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": "0b0ccda4-7f0e-4e34-9a39-1f0c6d3bb9c1",
                "captured_at": "2026-11-21T12:30:00+08:00",
                "time_zone": "Asia/Shanghai",
                "hints": [{"point": [812, 560], "food": "apple"}],
            }
        }
    )

    id: uuid.UUID = Field(
        description="Made by the phone, once a meal; the same id again is the same meal."
    )


class ImageOut(BaseModel):
    """One photograph that has arrived. `durable`: it is synced to disk and the phone may forget it."""

    received_sha256: str = Field(description="SHA-256 of the bytes that the phone sent, hex.")
    bytes: int = Field(description="Length of what is kept, bytes.")
    media_type: str = Field(description="Media type of what is kept, such as image/jpeg.")
    width_px: int = Field(description="Width of the upright picture.")
    height_px: int = Field(description="Height of the upright picture.")
    flags: list[str] = Field(
        description="`reencoded`: its picture was written anew to take its location out."
    )
    received_at: datetime = Field(description="When it arrived at the server.")
    durable: Literal[True] = Field(
        default=True, description="It is synced to disk: the phone may delete its copy."
    )


class VoiceNoteOut(BaseModel):
    """A meal's voice note. `durable`: it is synced to disk and the phone may forget it."""

    received_sha256: str = Field(description="SHA-256 of the bytes that the phone sent, hex.")
    bytes: int = Field(description="Its length, bytes.")
    media_type: str = Field(description="audio/webm or audio/mp4.")
    received_at: datetime = Field(description="When it arrived at the server.")
    durable: Literal[True] = Field(
        default=True, description="It is synced to disk: the phone may delete its copy."
    )


class FailureOut(BaseModel):
    """Why a meal could not be measured, for a person; what to do on the next try."""

    code: str = Field(description="Stable; docs/errors.md lists them.")
    message: str = Field(description="What went wrong, for a person.")
    advice: str = Field(description="What to do on the next try.")

    @computed_field(description="One sentence for the participant, by language: en, de, es, zh.")
    def localised(self) -> dict[str, str]:
        """From the code; empty for a code without a sentence."""
        told = {locale: sentence(self.code, locale) for locale in LOCALES}
        return {locale: text for locale, text in told.items() if text is not None}


class ArtefactOut(BaseModel):
    """A picture or point cloud of one step."""

    name: str = Field(description="The artefact's name in the run.")
    media_type: str = Field(description="Its media type, such as image/jpeg.")
    bytes: int = Field(description="Its length, bytes.")
    href: str = Field(description="Path of its content.")


class RunOut(BaseModel):
    """The execution of the pipeline that the items come from."""

    id: uuid.UUID = Field(description="The run's id.")
    method: str = Field(
        description="The method of measuring volumes: shape, paper or paper-strict (docs/volume.md)."
    )
    pipeline_version: str = Field(description="The version of the pipeline.")
    marker: str | None = Field(
        description="The board or the coin that the run looked for, such as plain:9x7:11; null: a rig, the cameras' "
        "poses or a depth map gave the scale."
    )
    camera: dict[str, Any] | None = Field(
        description="Intrinsics that the run used, of the left and the right photograph; null: it failed before it "
        "had any."
    )
    parameters: dict[str, Any] = Field(description="The run's options.")
    stages: dict[str, float] = Field(description="Seconds a step.")
    seconds: float = Field(description="How long the run took.")
    food_tables: list[str] = Field(
        description="The releases in force, the one that goes first at the head."
    )
    created_at: datetime = Field(description="When the run was saved.")
    artefacts: list[ArtefactOut] = Field(description="Pictures and point clouds of its steps.")


class CandidateOut(BaseModel):
    """A food that the item may be; source: who says so."""

    food: FoodRef = Field(description="The food that it may be.")
    probability: float | None = Field(description="By the source alone; null: a hint's.")
    source: CandidateSource = Field(
        description="hint, the phone's; index; or model, a network that the operator supplies"
    )
    reasons: list[str] = Field(
        description="What speaks for it, or against it, beside its looks: docs/identification.md."
    )


class ItemOut(BaseModel):
    """One food on the plate. Without a food or a volume, mass and nutrients are null and the meal needs review."""

    id: uuid.UUID = Field(description="The item's id: events name it.")
    status: RecordStatus = Field(
        description="proposed, needs_review, confirmed, corrected or rejected"
    )
    origin: ItemOrigin = Field(description="pipeline, declared, added, split or merged")
    polygon: list[list[tuple[float, float]]] = Field(
        description="Rings in the left photograph's upright pixels, holes by the even-odd rule."
    )
    food: FoodRef | None = Field(description=FOOD)
    lies_as: FoodForm | None = Field(
        description="How it was said to lie; null: as it usually does."
    )
    candidates: list[CandidateOut] = Field(
        description="A hint's, then the index's, best first: choose one by the event `set_food` with its key."
    )
    none_of_these: float | None = Field(
        description="Probability that it is none of the index's candidates; null: the index was not asked."
    )
    index_version: str | None = Field(
        description="Which index gave the candidates (docs/identification.md)."
    )
    volume_ml: float | None = Field(
        description="Null where it could not be measured: flag `not_measurable`."
    )
    volume_interval_ml: Interval
    density_g_per_ml: float | None = Field(
        description="Turned the volume into grams; null where a person set the grams."
    )
    density_sd_g_per_ml: float | None = Field(
        description="What the next item of this food may differ from it."
    )
    density_basis: DensityBasis | None = Field(
        description="study, measured, fao, portion, related or group."
    )
    density_source: str | None = Field(
        description="Who measured or published the density; null: none was used."
    )
    mass_g: float | None = Field(description="As seen, with peel, core and bone.")
    mass_interval_g: Interval
    edible_share: float | None = Field(description="Edible mass / mass as seen.")
    edible_g: float | None = Field(description="As served, without peel, core and bone.")
    share: float = Field(description="The participant's share of a dish that is shared.")
    left_g: float | None = Field(description="Edible grams left over; null: nobody has looked.")
    consumed_g: float | None = Field(
        description="(edible - left) x share; signed: below 0 is doubt, not food."
    )
    consumed_interval_g: Interval
    provisional: bool = Field(description="An after-meal pair may still come.")
    reviewed: bool = Field(description="A reviewer has had the last word, and the amount is known.")
    parent: uuid.UUID | None = Field(
        description="The item that it was split from, or that it came with."
    )
    open_probes: list[str] = Field(
        description="What the participant is to be asked of it: no camera sees it."
    )
    nutrients: list[NutrientAmount] = Field(description="Of what was consumed.")
    flags: list[str] = Field(description=FLAGS)


class TotalsOut(BaseModel):
    """The meal's items together; doubt that they share (the pair's, a food's density) is not averaged away."""

    consumed_g: float | None = Field(description="The sum of the items' consumed_g.")
    consumed_interval_g: Interval
    unmeasured_items: int = Field(
        description="Items whose mass is not known; above 0, the totals are incomplete."
    )
    nutrients: list[NutrientTotal] = Field(
        description="Totals of what was consumed, one entry per component."
    )


class LeftoverOut(BaseModel):
    """A piece in the after-meal pair. What is food_left of an item is taken from what was served; refuse is not."""

    model_config = ConfigDict(serialize_by_alias=True, validate_by_name=True)

    id: uuid.UUID = Field(description="The piece's id: the event `set_leftover` names it.")
    leftover_class: LeftoverClass = Field(
        alias="class", description="food_left, refuse or unmatched"
    )
    item: uuid.UUID | None = Field(description="The item of the meal that it was left of.")
    is_by_person: bool = Field(
        description="A person has said so; else it is the server's own match."
    )
    polygon: list[list[tuple[float, float]]] = Field(
        description="Rings in after_left's upright pixels, holes by the even-odd rule."
    )
    food: FoodRef | None = Field(description="The item's.")
    volume_ml: float | None = Field(description="Null where it could not be measured.")
    volume_interval_ml: Interval
    mass_g: float | None = Field(description="As seen, by the density of the item's food.")
    mass_interval_g: Interval
    flags: list[str] = Field(description=FLAGS)


class AfterOut(BaseModel):
    """The after-meal pair. It never moves the meal's own status."""

    status: AfterStatus | None = Field(
        description="null: nothing has come yet; receiving, queued, processing, estimated, needs_review, failed, or "
        "nothing_left, as a person said"
    )
    due_at: datetime | None = Field(
        description="Until then the records are provisional; null: no pair is waited for."
    )
    captured_at: datetime | None = Field(
        description="When after_left was taken; null: the phone has not said."
    )
    ignored: list[str] = Field(
        description="Fields that were told of it and that this server does not know."
    )
    images: dict[str, ImageOut] = Field(
        description="Photographs that have arrived, by slot: after_left, after_right."
    )
    missing: list[str] = Field(description="Slots whose photographs have not arrived.")
    failure: FailureOut | None = Field(
        description="Why the pair could not be measured: send another one."
    )
    leftovers: list[LeftoverOut] = Field(description="Pieces that were seen after the meal.")
    artefacts: list[ArtefactOut] = Field(description="Pictures and point clouds of the pair's run.")


class MealOut(BaseModel):
    """A meal: what has arrived, where it stands, what was found."""

    id: uuid.UUID = Field(description=MEAL_ID)
    study: str = Field(description=STUDY)
    participant: ParticipantCode
    status: MealStatus = Field(
        description="receiving, queued, processing, estimated, needs_review, failed or confirmed"
    )
    stage: str | None = Field(
        description="The pipeline's step while processing; `waits_for_room` between two tries."
    )
    captured_at: CapturedAt
    time_zone: str = Field(description=TIME_ZONE)
    local_date: LocalDate
    received_at: datetime = Field(description=RECEIVED_AT)
    version: int = Field(description=MEAL_VERSION)
    flags: list[str] = Field(description="Causes of doubt about the whole meal: `clock_doubtful`.")
    ignored: list[str] = Field(
        description="Fields of the metadata that this server does not know: kept with the meal, and heard by nobody."
    )
    images: dict[str, ImageOut] = Field(
        description="Photographs and depth maps that have arrived, by slot: left, right, view3 ..., left_depth ..."
    )
    missing: list[str] = Field(
        description="Announced slots whose photographs or maps have not arrived."
    )
    voice_note: VoiceNoteOut | None = Field(
        default=None,
        description="A recording by the participant: `GET /v1/meals/{id}/images/voice_note`; null: none.",
    )
    failure: FailureOut | None = Field(
        description="Why the meal could not be measured; null: it has not failed."
    )
    after: AfterOut | None = Field(
        description="null: no after-meal pair has come, and none is waited for."
    )
    items: list[ItemOut] = Field(description="The foods of the meal, rejected ones too.")
    totals: TotalsOut = Field(description="Sums over the items that count.")
    run: RunOut | None = Field(description="The run that the items come from; null: there is none.")
