"""SQL of a study's vessel library. Rows: (vessel, the version that it is of now)."""

import uuid
from collections.abc import Iterable, Sequence

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.vessels.models import StudyVessel, StudyVesselVersion

VesselRow = sa.Row[StudyVessel, StudyVesselVersion]


def page_of_vessels(
    session: Session,
    study_id: uuid.UUID,
    *,
    is_in_use: bool | None,
    after: str | None,
    limit: int,
) -> Sequence[VesselRow]:
    """A study's vessels by name, those behind the key `after`.

    is_in_use: only these; None: retired ones too.
    """
    query = _vessels(study_id).order_by(StudyVessel.name_key).limit(limit)
    if is_in_use is not None:
        query = query.where(StudyVesselVersion.is_retired.is_(not is_in_use))
    if after is not None:
        query = query.where(StudyVessel.name_key > after)
    return session.execute(query).all()


def vessels_for_estimate(
    session: Session, study_id: uuid.UUID, hinted_keys: Iterable[str]
) -> Sequence[VesselRow]:
    """A study's vessels in use, and retired ones with a key among hinted_keys, by name."""
    hinted = StudyVessel.name_key.in_(sorted(set(hinted_keys)))
    query = _vessels(study_id).where(sa.or_(StudyVesselVersion.is_retired.is_(False), hinted))
    return session.execute(query.order_by(StudyVessel.name_key)).all()


def vessel_keys(session: Session, study_id: uuid.UUID, keys: Iterable[str]) -> set[str]:
    """Those of the keys that name a vessel of this study, retired or not."""
    query = sa.select(StudyVessel.name_key).where(StudyVessel.study_id == study_id)
    return set(session.scalars(query.where(StudyVessel.name_key.in_(sorted(set(keys))))))


def find_vessel(session: Session, study_id: uuid.UUID, vessel_id: uuid.UUID) -> VesselRow | None:
    """A vessel of this study. Who changes it holds the study."""
    return session.execute(_vessels(study_id).where(StudyVessel.id == vessel_id)).one_or_none()


def find_vessel_by_key(session: Session, study_id: uuid.UUID, name_key: str) -> VesselRow | None:
    """The vessel of this study with this name_key."""
    return session.execute(_vessels(study_id).where(StudyVessel.name_key == name_key)).one_or_none()


def vessel_version(
    session: Session, vessel_id: uuid.UUID, version: int
) -> StudyVesselVersion | None:
    """What a vessel was in an earlier version."""
    return session.get(StudyVesselVersion, (vessel_id, version))


def count_in_use(session: Session, study_id: uuid.UUID) -> int:
    """How many vessels of a study are not retired."""
    query = _vessels(study_id).where(StudyVesselVersion.is_retired.is_(False))
    return session.scalar(sa.select(sa.func.count()).select_from(query.subquery())) or 0


def _vessels(study_id: uuid.UUID) -> sa.Select[StudyVessel, StudyVesselVersion]:
    is_current = sa.and_(
        StudyVesselVersion.vessel_id == StudyVessel.id,
        StudyVesselVersion.version == StudyVessel.version,
    )
    return (
        sa.select(StudyVessel, StudyVesselVersion)
        .join(StudyVesselVersion, is_current)
        .where(StudyVessel.study_id == study_id)
    )
