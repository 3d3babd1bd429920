"""HTTP schemas of cameras and their calibrations."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import PARTICIPANT
from app.http.text_schemas import JsonNumber, Text


class CameraIn(BaseModel):
    """Intrinsics of the phone's camera for upright pixels, as `tada calibrate` prints them."""

    model_config = ConfigDict(extra="ignore")  # `tada calibrate` also prints rms_px and more

    width: int = Field(gt=0, le=100_000, description="Width of the upright pictures, px.")
    height: int = Field(gt=0, le=100_000, description="Height of the same pictures, px.")
    fx: JsonNumber = Field(gt=0, description="Focal length across, px.")
    fy: JsonNumber = Field(gt=0, description="Focal length down, px.")
    cx: JsonNumber = Field(description="Principal point from the left edge, px.")
    cy: JsonNumber = Field(description="Principal point from the upper edge, px.")
    distortion: tuple[JsonNumber, JsonNumber, JsonNumber, JsonNumber, JsonNumber] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="k1, k2, p1, p2, k3"
    )


Row = tuple[JsonNumber, JsonNumber, JsonNumber]


class RigIn(BaseModel):
    """A stereo rig, two cameras that are fixed to each other, as `tada calibrate --rig --json` prints it.

    A width and a height beside the cameras are those of each camera that has none of its own.
    """

    model_config = ConfigDict(extra="ignore")  # `tada calibrate` also prints baseline_mm and more

    left: CameraIn = Field(description="The left camera.")
    right: CameraIn = Field(description="The right camera.")
    R: tuple[Row, Row, Row] = Field(
        description="Rotation from the left to the right camera: x_right = R x_left + t_mm."
    )
    t_mm: Row = Field(description="Translation of the same, mm; its length is the baseline.")
    rms_px: Annotated[JsonNumber, Field(ge=0)] | None = Field(
        default=None, description="Reprojection error (rms) of the board's corners, px."
    )
    pairs: int | None = Field(
        default=None, ge=0, le=100_000, description="Number of pairs of photographs used."
    )

    @model_validator(mode="before")
    @classmethod
    def _share_size(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        shared = {key: data[key] for key in ("width", "height") if key in data}
        cameras = {
            side: shared | data[side]
            for side in ("left", "right")
            if isinstance(data.get(side), dict)
        }
        return data | cameras


class RigOut(BaseModel):
    """A stereo rig: x_right = R x_left + t_mm."""

    left: CameraIn = Field(description="The left camera.")
    right: CameraIn = Field(description="The right camera.")
    R: list[list[float]] = Field(description="Rotation from the left to the right camera.")
    t_mm: list[float] = Field(description="Translation of the same, mm.")


class CalibrationMetadataIn(ClosedModel):
    """Metadata of the photographs; all fields are optional."""

    model_config = ConfigDict(json_schema_extra={"example": {"marker": "plain:9x7:11"}})

    marker: Text | None = Field(
        default=None,
        max_length=64,
        description="The board, such as plain:9x7:11; default: the study's.",
    )


class LeftOutPhotographOut(BaseModel):
    """A photograph that was not used."""

    photograph: int = Field(description="The photograph's number, from 1, in the order sent.")
    code: str = Field(description="Why it was not used: a stable code (docs/errors.md).")
    message: str = Field(description="Why it was not used, as a sentence.")


class CalibrationOut(BaseModel):
    """A measured camera or rig. The phone's meals use the newest of each kind that is not withdrawn."""

    id: uuid.UUID = Field(description="The calibration's id.")
    kind: Literal["camera", "rig"] = Field(
        description="camera: one camera, for meals with a marker. rig: a stereo rig."
    )
    model: str | None = Field(
        description="The phone's model, from the photographs or its app; null: not known, or all."
    )
    marker: str | None = Field(
        description="The board that was photographed, such as plain:9x7:11; null: of a rig."
    )
    camera: CameraIn = Field(
        description="The measured intrinsics; of a rig, those of its left camera."
    )
    rig: RigOut | None = Field(description="The rig; null: a single camera.")
    rms_px: float | None = Field(
        description="Reprojection error (rms) of the board's corners, px; null: a rig sent without it."
    )
    photographs: int | None = Field(
        description="Number of photographs used; of a rig, of pairs; null: a rig sent without it."
    )
    created_at: datetime = Field(description="When it was measured or sent.")
    withdrawn_at: datetime | None = Field(description="When it was withdrawn; null: it is in use.")


class NewCalibrationOut(CalibrationOut):
    """A new calibration and the photographs that were not used."""

    left_out: list[LeftOutPhotographOut] = Field(
        description="Photographs that were not used, with reasons."
    )


class StudyCalibrationOut(CalibrationOut):
    """A calibration, its phone and participant."""

    participant: str | None = Field(description=f"{PARTICIPANT} null: staff sent it for the study.")
    device_id: uuid.UUID | None = Field(
        description="The phone's id; null: staff sent it for the study."
    )


class CalibrationList(BaseModel):
    """A phone's calibrations, the newest first."""

    items: list[CalibrationOut] = Field(
        description="The phone's calibrations, including withdrawn ones."
    )


class StudyCalibrationList(BaseModel):
    """A study's calibrations, the newest first, at most 1,000."""

    items: list[StudyCalibrationOut] = Field(
        description="The calibrations of the study and of its phones, including withdrawn ones."
    )
