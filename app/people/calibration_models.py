"""Intrinsics of phones' cameras, measured from photographs of a board."""

import uuid
from datetime import datetime
from typing import TypedDict

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonValue, Personal


class CameraDetails(TypedDict):
    """Intrinsics of a camera for upright pixels, px. distortion: k1, k2, p1, p2, k3."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: list[float]


class CameraCalibration(Base):
    """A calibration; a phone uses its newest one that is not withdrawn. device_id: NULL if staff made it for a model.

    rms_px: reprojection error of the board's corners.
    """

    __tablename__ = "camera_calibration"
    personal = Personal(("device_id",), "camera_calibrations")

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    device_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("device.id"), index=True)
    model: Mapped[str | None] = mapped_column(sa.String(200), index=True)
    marker: Mapped[str] = mapped_column(sa.String(64))
    camera: Mapped[CameraDetails] = mapped_column(JsonValue)
    rms_px: Mapped[float]
    photographs: Mapped[int]
    author: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
