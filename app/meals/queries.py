"""SQL of meals and their photographs."""

import uuid
from collections.abc import Collection, Iterator, Sequence
from datetime import date, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.day_models import DiaryDay
from app.meals.job_models import Job
from app.meals.models import Meal, MealImage
from app.people.models import Participant, Study

WAITING = ("queued", "processing")
UNESTIMATED = ("receiving", *WAITING)  # nothing is known yet of what is on the plate


def lock_meal(session: Session, meal_id: uuid.UUID) -> Meal | None:
    """The meal, locked for this transaction (SQLite's write transactions are alone anyway), and as it is by then."""
    query = sa.select(Meal).where(Meal.id == meal_id).with_for_update()
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def images_of(session: Session, meal_id: uuid.UUID) -> list[MealImage]:
    """A meal's photographs by slot."""
    return list(session.scalars(sa.select(MealImage).where(MealImage.meal_id == meal_id).order_by(MealImage.slot)))


def blob_keys(session: Session) -> Iterator[str]:
    """The keys of all photographs that are kept, streamed."""
    kept = sa.select(MealImage.blob_key).where(MealImage.erased_at.is_(None))
    yield from session.scalars(kept.execution_options(yield_per=1000))


def find_meals(
    session: Session,
    client_id: uuid.UUID,
    *,
    participant_id: uuid.UUID | None,
    participant_code: str | None,
    study_ids: Collection[uuid.UUID] | None,
) -> list[tuple[Meal, str, str]]:
    """(meal, participant's code, study's code) of all meals of this client id that the filters leave, at most two.

    The one that was here first comes first: who sends another person's id does not take its place.
    """
    query = (
        sa.select(Meal, Participant.code, Study.code)
        .join(Participant, Participant.id == Meal.participant_id)
        .join(Study, Study.id == Meal.study_id)
        .where(Meal.client_id == client_id)
        .order_by(Meal.received_at, Meal.id)
        .limit(2)
    )
    if participant_id is not None:
        query = query.where(Meal.participant_id == participant_id)
    if study_ids is not None:
        query = query.where(Meal.study_id.in_(study_ids))
    if participant_code is not None:
        query = query.where(Participant.code == participant_code)
    return [(meal, participant, study) for meal, participant, study in session.execute(query)]


def versions_of(session: Session, meal_ids: Collection[uuid.UUID]) -> Sequence[sa.Row[*tuple[Any, ...]]]:
    """(id, version) of these meals: what the waiters' poller asks for."""
    return session.execute(sa.select(Meal.id, Meal.version).where(Meal.id.in_(meal_ids))).all()


def set_progress(session: Session, meal_id: uuid.UUID, *, status: str, stage: str | None) -> None:
    """Move a waiting meal on; one that is finished meanwhile is left alone."""
    session.execute(
        sa.update(Meal)
        .where(Meal.id == meal_id, Meal.status.in_(WAITING))
        .values(status=status, stage=stage, version=Meal.version + 1)
    )


def after_windows_over(session: Session, now: datetime, limit: int) -> list[uuid.UUID]:
    """Meals whose time for an after-meal pair is over while none is about to be measured, the longest over first."""
    is_still = sa.or_(Meal.after_status.is_(None), Meal.after_status.not_in(WAITING))
    query = sa.select(Meal.id).where(Meal.after_due_at <= now, is_still).order_by(Meal.after_due_at).limit(limit)
    return list(session.scalars(query))


def oldest_waiting(session: Session) -> datetime | None:
    """Since when the meal that has waited longest waits: since it was submitted, or queued again."""
    return session.execute(sa.select(sa.func.min(Job.enqueued_at)).where(Job.state == "queued")).scalar_one()


def first_days(session: Session, participant_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, date]:
    """Participant -> the study's day 1 for them; absent where neither a start, a meal nor a closed day is known."""
    first_meal = sa.select(sa.func.min(Meal.local_date)).where(Meal.participant_id == Participant.id).scalar_subquery()
    first_closed = (
        sa.select(sa.func.min(DiaryDay.local_date))
        .where(DiaryDay.participant_id == Participant.id, DiaryDay.status == "closed")
        .scalar_subquery()
    )
    query = sa.select(Participant.id, Participant.starts_on, first_meal, first_closed)
    found: dict[uuid.UUID, date] = {}
    for ids in _batches(participant_ids):
        for participant_id, starts_on, meal, closed in session.execute(query.where(Participant.id.in_(ids))):
            known = [day for day in (meal, closed) if day is not None]
            if starts_on is not None or known:
                found[participant_id] = starts_on or min(known)
    return found


def _batches(ids: Collection[uuid.UUID], size: int = 500) -> Iterator[list[uuid.UUID]]:
    """So many at a time: a statement takes only so many parameters."""
    every = sorted(set(ids))
    yield from (every[start : start + size] for start in range(0, len(every), size))
