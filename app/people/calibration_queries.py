"""SQL of calibrations: cameras and rigs."""

import uuid
from collections.abc import Sequence
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.people.models import CameraCalibration, Device, Participant

MAX_DEVICES = 1000  # of one model in one study: enough for a median


IS_CAMERA, IS_RIG = CameraCalibration.rig.is_(None), CameraCalibration.rig.is_not(None)
NEWEST_FIRST = CameraCalibration.created_at.desc(), CameraCalibration.id.desc()


def newest_of_device(session: Session, device_id: uuid.UUID) -> CameraCalibration | None:
    """Return the camera calibration that a phone uses."""
    return _newest(session, IS_CAMERA, CameraCalibration.device_id == device_id)


def newest_rig_of_device(
    session: Session, device_id: uuid.UUID, before: datetime | None
) -> CameraCalibration | None:
    """Return a phone's own rig. before: kept by then; None: at any time."""
    return _newest(session, *_rigs_by(before), CameraCalibration.device_id == device_id)


def newest_rig_of_study(
    session: Session, study_id: uuid.UUID, model: str | None, before: datetime | None
) -> CameraCalibration | None:
    """Return the rig that staff sent for the study's phones of this model; None: for all.

    before: kept by then.
    """
    of_study = CameraCalibration.study_id == study_id, CameraCalibration.model == model
    return _newest(session, *_rigs_by(before), *of_study)


def _rigs_by(before: datetime | None) -> list[sa.ColumnElement[bool]]:
    return [IS_RIG] if before is None else [IS_RIG, CameraCalibration.created_at <= before]


def _newest(session: Session, *conditions: sa.ColumnElement[bool]) -> CameraCalibration | None:
    return session.scalars(
        sa.select(CameraCalibration)
        .where(CameraCalibration.withdrawn_at.is_(None), *conditions)
        .order_by(*NEWEST_FIRST)
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
                order_by=NEWEST_FIRST,
            )
            .label("age"),
        )
        .join(Device, Device.id == CameraCalibration.device_id)
        .join(Participant, Participant.id == Device.participant_id)
        .where(
            IS_CAMERA,
            Participant.study_id == study_id,
            sa.or_(CameraCalibration.model == model, Device.model == model),
            CameraCalibration.withdrawn_at.is_(None),
        )
        .subquery()
    )
    newest = sa.select(ranked.c.id).where(ranked.c.age == 1).limit(MAX_DEVICES)
    return list(
        session.scalars(sa.select(CameraCalibration).where(CameraCalibration.id.in_(newest)))
    )


def of_device(session: Session, device_id: uuid.UUID, limit: int) -> Sequence[CameraCalibration]:
    """Return a phone's calibrations, including withdrawn ones, the newest first."""
    return session.scalars(
        sa.select(CameraCalibration)
        .where(CameraCalibration.device_id == device_id)
        .order_by(*NEWEST_FIRST)
        .limit(limit)
    ).all()


def of_study(
    session: Session, study_id: uuid.UUID, limit: int
) -> list[tuple[CameraCalibration, str | None]]:
    """Return (calibration, participant's code) of a study and its phones, withdrawn ones too, the newest first."""
    rows = session.execute(
        sa.select(CameraCalibration, Participant.code)
        .outerjoin(Device, Device.id == CameraCalibration.device_id)
        .outerjoin(Participant, Participant.id == Device.participant_id)
        .where(sa.or_(Participant.study_id == study_id, CameraCalibration.study_id == study_id))
        .order_by(*NEWEST_FIRST)
        .limit(limit)
    )
    return [(calibration, code) for calibration, code in rows]


def find(
    session: Session, calibration_id: uuid.UUID
) -> tuple[CameraCalibration, uuid.UUID, uuid.UUID | None] | None:
    """Return (calibration, its study's id, its participant's alias; None: the study's own)."""
    row = session.execute(
        sa.select(
            CameraCalibration,
            sa.func.coalesce(Participant.study_id, CameraCalibration.study_id),
            Participant.alias,
        )
        .outerjoin(Device, Device.id == CameraCalibration.device_id)
        .outerjoin(Participant, Participant.id == Device.participant_id)
        .where(CameraCalibration.id == calibration_id)
    ).one_or_none()
    return None if row is None else (row[0], row[1], row[2])


def count_of_device(session: Session, device_id: uuid.UUID) -> int:
    """Count the calibrations that a phone has sent."""
    return _count(session, CameraCalibration.device_id == device_id)


def count_rigs_of_study(session: Session, study_id: uuid.UUID) -> int:
    """Count the rigs that staff sent for the study's phones and did not withdraw."""
    return _count(
        session, CameraCalibration.study_id == study_id, CameraCalibration.withdrawn_at.is_(None)
    )


def _count(session: Session, *conditions: sa.ColumnElement[bool]) -> int:
    return session.execute(
        sa.select(sa.func.count()).select_from(CameraCalibration).where(*conditions)
    ).scalar_one()
