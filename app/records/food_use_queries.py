"""SQL of how many records of each study have a food."""

import uuid
from collections.abc import Collection
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.record_models import EffectiveRecord
from app.people.models import Study
from app.records.conditions import holds


@dataclass(frozen=True, slots=True)
class StudyRecords:
    """How many records of a study that hold were taken for a food."""

    study_id: uuid.UUID
    code: str
    name: str
    records: int


def records_by_study(
    session: Session, food_ids: Collection[int], study_ids: Collection[uuid.UUID] | None, *, most: int, studies: int
) -> list[StudyRecords]:
    """The first of these studies (None: of all), by code, with their records of these foods that hold, `most` at most.

    Read in the index of a food's records, study by study, and never further than `most`.
    """
    counted = (
        sa.select(sa.literal(1).label("one"))
        .where(EffectiveRecord.food_id.in_(food_ids), EffectiveRecord.study_id == Study.id, holds(EffectiveRecord))
        .limit(most)
        .correlate(Study)
        .subquery()
    )
    records = sa.select(sa.func.count()).select_from(counted).scalar_subquery()
    query = sa.select(Study.id, Study.code, Study.name, records).order_by(Study.code).limit(studies)
    if study_ids is not None:
        query = query.where(Study.id.in_(study_ids))
    return [StudyRecords(*row) for row in session.execute(query)]
