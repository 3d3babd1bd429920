"""Calibrations: intrinsics of phones' cameras, measured from photographs of a board, and stereo rigs."""

import uuid
from datetime import datetime
from typing import TypedDict

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonValue, Personal


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

    rig: of the kind "rig"; camera is then its left one. device_id: NULL if staff sent it for the phones of study_id,
    all of them or those of a model. rms_px: reprojection error of the board's corners. photographs: number used.
    """

    __tablename__ = "camera_calibration"
    personal = Personal(("device_id",), "camera_calibrations")

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    device_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("device.id"), index=True)
    study_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("study.id"), index=True)
    model: Mapped[str | None] = mapped_column(sa.String(200), index=True)
    marker: Mapped[str | None] = mapped_column(sa.String(64))
    camera: Mapped[CameraDetails] = mapped_column(JsonValue)
    rig: Mapped[RigDetails | None] = mapped_column(JsonValue)
    rms_px: Mapped[float | None]
    photographs: Mapped[int | None]
    author: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
