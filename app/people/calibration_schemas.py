"""Cameras of phones on the wire."""

import uuid
from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field

from app.http.field_descriptions import PARTICIPANT
from app.http.text_schemas import JsonNumber, Text


class CameraIn(BaseModel):
    """Intrinsics of the phone's camera for upright pixels, as `tada calibrate` prints them."""

    model_config = ConfigDict(extra="ignore")  # `tada calibrate` also prints rms_px and more

    width: int = Field(gt=0, le=100_000, description="Width of the upright pictures that the intrinsics are of, px.")
    height: int = Field(gt=0, le=100_000, description="Height of the same pictures, px.")
    fx: JsonNumber = Field(gt=0, description="Focal length across, px.")
    fy: JsonNumber = Field(gt=0, description="Focal length down, px.")
    cx: JsonNumber = Field(description="Principal point from the left edge, px.")
    cy: JsonNumber = Field(description="Principal point from the upper edge, px.")
    distortion: tuple[JsonNumber, JsonNumber, JsonNumber, JsonNumber, JsonNumber] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="k1, k2, p1, p2, k3"
    )


class CalibrationMetadataIn(BaseModel):
    """Beside the photographs; all of it may be left out."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"marker": "plain:9x7:11"}})

    marker: Text | None = Field(default=None, max_length=64, description="KIND:COLSxROWS:MM; default: the study's.")


class LeftOutPhotographOut(BaseModel):
    """A photograph that was not used."""

    photograph: int = Field(description="From 1, as sent.")
    code: str = Field(description="Why it was not used: a stable code (docs/errors.md).")
    message: str = Field(description="The same in a sentence.")


class CalibrationOut(BaseModel):
    """A camera as it was measured. The newest that is not withdrawn holds for the phone's meals."""

    id: uuid.UUID = Field(description="The calibration's id.")
    model: str | None = Field(description="The phone's, as the photographs or its app tell it.")
    marker: str = Field(description="The board that was photographed, KIND:COLSxROWS:MM.")
    camera: CameraIn = Field(description="The intrinsics that were measured.")
    rms_px: float = Field(description="How well the board's corners fit.")
    photographs: int = Field(description="Used.")
    created_at: datetime = Field(description="When it was measured.")
    withdrawn_at: datetime | None = Field(description="Since when it is not used any more; null: it is in use.")


class NewCalibrationOut(CalibrationOut):
    """A calibration that was just made."""

    left_out: list[LeftOutPhotographOut] = Field(description="Photographs that were not used, each with its reason.")


class StudyCalibrationOut(CalibrationOut):
    """A calibration with whose phone it is of."""

    participant: str = Field(description=PARTICIPANT)
    device_id: uuid.UUID | None = Field(description="The phone's id; null: staff measured it for a phone model.")


class CalibrationList(BaseModel):
    """A phone's calibrations, the newest first."""

    items: list[CalibrationOut] = Field(description="The phone's calibrations, withdrawn ones too.")


class StudyCalibrationList(BaseModel):
    """A study's calibrations, the newest first, a thousand at most."""

    items: list[StudyCalibrationOut] = Field(description="The calibrations of the study's phones, withdrawn ones too.")
