"""HTTP schemas of cameras and their calibrations."""

import uuid
from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field

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


class CalibrationMetadataIn(BaseModel):
    """Metadata of the photographs; all fields are optional."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"marker": "plain:9x7:11"}})

    marker: Text | None = Field(
        default=None, max_length=64, description="The board, such as plain:9x7:11; default: the study's."
    )


class LeftOutPhotographOut(BaseModel):
    """A photograph that was not used."""

    photograph: int = Field(description="The photograph's number, from 1, in the order sent.")
    code: str = Field(description="Why it was not used: a stable code (docs/errors.md).")
    message: str = Field(description="Why it was not used, as a sentence.")


class CalibrationOut(BaseModel):
    """A measured camera. The phone's meals use the newest calibration that is not withdrawn."""

    id: uuid.UUID = Field(description="The calibration's id.")
    model: str | None = Field(description="The phone's model, from the photographs or its app.")
    marker: str = Field(description="The board that was photographed, such as plain:9x7:11.")
    camera: CameraIn = Field(description="The measured intrinsics.")
    rms_px: float = Field(description="Reprojection error (rms) of the board's corners, px.")
    photographs: int = Field(description="Number of photographs used.")
    created_at: datetime = Field(description="When it was measured.")
    withdrawn_at: datetime | None = Field(description="When it was withdrawn; null: it is in use.")


class NewCalibrationOut(CalibrationOut):
    """A new calibration and the photographs that were not used."""

    left_out: list[LeftOutPhotographOut] = Field(description="Photographs that were not used, with reasons.")


class StudyCalibrationOut(CalibrationOut):
    """A calibration, its phone and participant."""

    participant: str = Field(description=PARTICIPANT)
    device_id: uuid.UUID | None = Field(description="The phone's id; null: staff measured it for a phone model.")


class CalibrationList(BaseModel):
    """A phone's calibrations, the newest first."""

    items: list[CalibrationOut] = Field(description="The phone's calibrations, including withdrawn ones.")


class StudyCalibrationList(BaseModel):
    """A study's calibrations, the newest first, at most 1,000."""

    items: list[StudyCalibrationOut] = Field(
        description="The calibrations of the study's phones, including withdrawn ones."
    )
