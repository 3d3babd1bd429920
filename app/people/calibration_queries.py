"""SQL of camera calibrations."""

import uuid
from collections.abc import Sequence

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.people.calibration_models import CameraCalibration
from app.people.models import Device, Participant

MAX_DEVICES = 1000  # of one model in one study: enough for a median


def newest_of_device(session: Session, device_id: uuid.UUID) -> CameraCalibration | None:
    """Return the calibration that a phone uses."""
    return session.scalars(
        sa.select(CameraCalibration)
        .where(CameraCalibration.device_id == device_id, CameraCalibration.withdrawn_at.is_(None))
        .order_by(CameraCalibration.created_at.desc(), CameraCalibration.id.desc())
        .limit(1)
    ).one_or_none()


def model_of_device(session: Session, device_id: uuid.UUID) -> str | None:
    """Return the phone's model: from EXIF of its calibration, else as its app named it."""
    newest = newest_of_device(session, device_id)
    if newest is not None and newest.model is not None:
        return newest.model
    return session.scalars(sa.select(Device.model).where(Device.id == device_id)).one_or_none()


def newest_of_model(session: Session, study_id: uuid.UUID, model: str) -> list[CameraCalibration]:
    """Return the calibrations that the study's phones of a model use."""
    ranked = (
        sa.select(
            CameraCalibration.id,
            sa.func.row_number()
            .over(
                partition_by=CameraCalibration.device_id,
                order_by=(CameraCalibration.created_at.desc(), CameraCalibration.id.desc()),
            )
            .label("age"),
        )
        .join(Device, Device.id == CameraCalibration.device_id)
        .join(Participant, Participant.id == Device.participant_id)
        .where(
            Participant.study_id == study_id,
            sa.or_(CameraCalibration.model == model, Device.model == model),
            CameraCalibration.withdrawn_at.is_(None),
        )
        .subquery()
    )
    newest = sa.select(ranked.c.id).where(ranked.c.age == 1).limit(MAX_DEVICES)
    return list(session.scalars(sa.select(CameraCalibration).where(CameraCalibration.id.in_(newest))))


def of_device(session: Session, device_id: uuid.UUID, limit: int) -> Sequence[CameraCalibration]:
    """Return a phone's calibrations, including withdrawn ones, the newest first."""
    return session.scalars(
        sa.select(CameraCalibration)
        .where(CameraCalibration.device_id == device_id)
        .order_by(CameraCalibration.created_at.desc(), CameraCalibration.id.desc())
        .limit(limit)
    ).all()


def of_study(session: Session, study_id: uuid.UUID, limit: int) -> list[tuple[CameraCalibration, str]]:
    """Return (calibration, participant's code) of the study's phones, including withdrawn ones, the newest first."""
    rows = session.execute(
        sa.select(CameraCalibration, Participant.code)
        .join(Device, Device.id == CameraCalibration.device_id)
        .join(Participant, Participant.id == Device.participant_id)
        .where(Participant.study_id == study_id)
        .order_by(CameraCalibration.created_at.desc(), CameraCalibration.id.desc())
        .limit(limit)
    )
    return [(calibration, code) for calibration, code in rows]


def find(session: Session, calibration_id: uuid.UUID) -> tuple[CameraCalibration, uuid.UUID, uuid.UUID] | None:
    """Return (calibration, its study's id, its participant's alias)."""
    row = session.execute(
        sa.select(CameraCalibration, Participant.study_id, Participant.alias)
        .join(Device, Device.id == CameraCalibration.device_id)
        .join(Participant, Participant.id == Device.participant_id)
        .where(CameraCalibration.id == calibration_id)
    ).one_or_none()
    return None if row is None else (row[0], row[1], row[2])


def count_of_device(session: Session, device_id: uuid.UUID) -> int:
    """Count the calibrations that a phone has sent."""
    query = sa.select(sa.func.count()).select_from(CameraCalibration).where(CameraCalibration.device_id == device_id)
    return session.execute(query).scalar_one()
