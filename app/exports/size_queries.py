"""How many rows a table would have, counted no further than matters to who is about to download it."""

import uuid

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.models import Meal
from app.people.models import Participant
from app.records.page_queries import RecordFilter, RecordSearch


def count_records(session: Session, search: RecordSearch, most: int) -> int:
    """Records that a search finds, `most` at most."""
    page = search.page(None, most)
    return session.scalar(sa.select(sa.func.count()).select_from(page)) or 0


def count_meals(session: Session, study_id: uuid.UUID, chosen: RecordFilter, most: int) -> int:
    """Meals of a participant (None: of all) within local days, `most` at most."""
    query = sa.select(Meal.id).where(Meal.study_id == study_id)
    if chosen.participant_code is not None:
        query = query.join(Participant, Participant.id == Meal.participant_id)
        query = query.where(Participant.code == chosen.participant_code)
    if chosen.first_day is not None:
        query = query.where(Meal.local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(Meal.local_date <= chosen.last_day)
    return session.scalar(sa.select(sa.func.count()).select_from(query.limit(most).subquery())) or 0
