"""Intrinsics of phones' cameras, measured from photographs of a board."""

import uuid
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal


class CameraCalibration(Base):
    """One calibration; the newest that is not withdrawn holds. device_id: whose phone; NULL: by staff, for a model.

    camera: width, height, fx, fy, cx, cy, distortion, for upright pixels. rms_px: reprojection error of the corners.
    """

    __tablename__ = "camera_calibration"
    personal = Personal(("device_id",), "camera_calibrations")

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    device_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("device.id"), index=True)
    model: Mapped[str | None] = mapped_column(sa.String(200), index=True)
    marker: Mapped[str] = mapped_column(sa.String(64))
    camera: Mapped[dict[str, Any]]
    rms_px: Mapped[float]
    photographs: Mapped[int]
    author: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
