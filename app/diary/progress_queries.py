"""SQL of who is behind: a study's participants with their phones, last entries, open questions and unmeasured meals."""

import uuid
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.day_definition import count_where
from app.diary.overview_queries import AFTER_PENDING
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import Meal
from app.people.models import Device, Participant
from app.records.page_queries import waits_for_answer, was_asked


def participants_now(session: Session, study_id: uuid.UUID) -> Sequence[sa.Row[Any]]:
    """Return a study's participants by code, with how they stand now.

    Columns: those of Participant, enrolled_at, phone_seen_at, last_meal, last_closed, failed_meals,
    waiting_meals, open_questions; None where there is nothing.
    """
    phones = sa.select(
        Device.participant_id,
        sa.func.min(Device.enrolled_at).label("enrolled_at"),
        sa.func.max(Device.last_used_at).label("phone_seen_at"),
    )
    meals = sa.select(
        Meal.participant_id,
        sa.func.max(Meal.local_date).label("last_meal"),
        count_where(Meal.status == "failed").label("failed_meals"),
        count_where(Meal.status.in_(AFTER_PENDING)).label("waiting_meals"),
        count_where(sa.and_(was_asked(), waits_for_answer(Meal.id))).label("open_questions"),
    ).where(Meal.study_id == study_id)
    closed = sa.select(
        DiaryDay.participant_id, sa.func.max(DiaryDay.local_date).label("last_closed")
    ).where(DiaryDay.study_id == study_id, DiaryDay.status == "closed")
    query = sa.select(Participant.__table__)
    for part in (phones, meals, closed):
        table = part.group_by("participant_id").subquery()
        participant_id, *figures = table.c
        query = query.outerjoin(table, participant_id == Participant.id).add_columns(*figures)
    return session.execute(
        query.where(Participant.study_id == study_id).order_by(Participant.code)
    ).all()
