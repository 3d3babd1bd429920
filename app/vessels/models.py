"""A study's vessel library: mugs and bowls that were measured once."""

import uuid
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, one_of
from app.db.columns import Str100, Str200, Str300, StudyRef, UuidKey, Version
from app.vision.vessel_library import VESSEL_KINDS, VesselKind


class StudyVessel(Base):
    """A vessel of a study.

    Its name never changes, since hints and runs refer to it; its measures are of `version`.

    name_key: the name as it is compared, without case: unique in the study.
    """

    __tablename__ = "study_vessel"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    name: Mapped[Str100]
    # folding case makes three characters of one at the most
    name_key: Mapped[Str300]
    version: Mapped[Version]
    created_at: Mapped[datetime]

    __table_args__ = (sa.Index(None, "study_id", "name_key", unique=True),)


class StudyVesselVersion(Base):
    """What a vessel measured from this version on, and whether it was in use.

    Never changed: runs refer to it.

    Lengths and volumes as they were typed; see vision/vessel_library.py. fill_line_mm: over the
    table. author: who measured, retired or restored it.
    """

    __tablename__ = "study_vessel_version"

    vessel_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study_vessel.id"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    kind: Mapped[VesselKind] = mapped_column(sa.String(16))
    rim_diameter_mm: Mapped[float]
    height_mm: Mapped[float]
    capacity_ml: Mapped[float | None]
    fill_line_mm: Mapped[float | None]
    fill_line_ml: Mapped[float | None]
    inside_profile_mm: Mapped[list[list[float]]]
    is_retired: Mapped[bool]
    author: Mapped[Str200]
    changed_at: Mapped[datetime]

    __table_args__ = (
        one_of("kind", VESSEL_KINDS),
        sa.CheckConstraint(
            "(fill_line_mm IS NULL) = (fill_line_ml IS NULL)", name="whole_fill_line"
        ),
    )
