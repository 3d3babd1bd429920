"""SQL of exported participants."""

from collections.abc import Iterator
from datetime import date, datetime
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.http.row_filter import RowFilter
from app.meals.models import Meal
from app.people.models import Device, Participant, Study
from app.records.page_queries import participants_of, studies_of

PARTICIPANTS_A_BATCH = 500


class ExportedParticipant(NamedTuple):
    """A participant with their study's code. enrolled_at: of the first phone. The last three: of the meals."""

    person: Participant
    study_code: str
    enrolled_at: datetime | None
    meals: int
    first_meal_on: date | None
    last_meal_on: date | None


def batches_of_participants(session: Session, chosen: RowFilter) -> Iterator[list[ExportedParticipant]]:
    """Yield the participants of these studies and of this code, by study and code."""
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    ids = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    enrolled_at = sa.select(sa.func.min(Device.enrolled_at)).where(Device.participant_id == Participant.id)
    of_meals = (sa.func.count(), sa.func.min(Meal.local_date), sa.func.max(Meal.local_date))
    query = (
        sa.select(
            Participant,
            Study.code,
            enrolled_at.scalar_subquery(),
            *(sa.select(value).where(Meal.participant_id == Participant.id).scalar_subquery() for value in of_meals),
        )
        .join(Study, Study.id == Participant.study_id)
        .order_by(Study.code, Participant.code)
    )
    if studies is not None:
        query = query.where(Participant.study_id.in_(studies))
    if ids is not None:
        query = query.where(Participant.id.in_(ids))
    for rows in session.execute(query.execution_options(yield_per=PARTICIPANTS_A_BATCH)).partitions():
        yield [ExportedParticipant._make(row) for row in rows]
