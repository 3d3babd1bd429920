"""SQL of meals and their photographs."""

import uuid
from collections.abc import Collection, Iterator, Sequence
from datetime import date, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session, undefer

from app.meals.stored.event_models import DiaryDay
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.people.models import Participant, Study

WAITING = ("queued", "processing")
UNESTIMATED = ("receiving", *WAITING)  # the plate's content is not known yet

# Statements of each GET of a meal or page of records, made once: that takes longer than to execute them
MEAL_ID, CLIENT_ID, PARTICIPANT_IDS = "meal_id", "client_id", "participant_ids"  # their parameters
IMAGES = (
    sa.select(MealImage).where(MealImage.meal_id == sa.bindparam(MEAL_ID)).order_by(MealImage.slot)
)
MEALS = (
    sa.select(Meal, Participant.code, Study.code)
    .join(Participant, Participant.id == Meal.participant_id)
    .join(Study, Study.id == Meal.study_id)
    .where(Meal.client_id == sa.bindparam(CLIENT_ID))
    .order_by(Meal.received_at, Meal.id)
    .limit(2)
    .options(undefer(Meal.leftovers))
)
FIRST_DAYS = sa.select(  # start, first meal and first closed day
    Participant.id,
    Participant.starts_on,
    sa.select(sa.func.min(Meal.local_date))
    .where(Meal.participant_id == Participant.id)
    .scalar_subquery(),
    sa.select(sa.func.min(DiaryDay.local_date))
    .where(DiaryDay.participant_id == Participant.id, DiaryDay.status == "closed")
    .scalar_subquery(),
).where(Participant.id.in_(sa.bindparam(PARTICIPANT_IDS, expanding=True)))


def lock_meal(session: Session, meal_id: uuid.UUID) -> Meal | None:
    """Return the meal as committed, locked for this transaction (on SQLite, write transactions exclude each other)."""
    query = sa.select(Meal).where(Meal.id == meal_id).with_for_update()
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def images_of(session: Session, meal_id: uuid.UUID) -> list[MealImage]:
    """Return a meal's photographs, ordered by slot."""
    return list(session.scalars(IMAGES, {MEAL_ID: meal_id}))


def images_by_slot(session: Session, meal_id: uuid.UUID) -> dict[str, MealImage]:
    """Return slot -> a meal's photograph."""
    return {image.slot: image for image in images_of(session, meal_id)}


def blob_keys(session: Session) -> Iterator[str]:
    """Yield the blob keys of all stored photographs."""
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
    """Return (meal, participant's code, study's code) of the filtered meals with this client id, at most two.

    The oldest comes first, so that a phone which sends another person's id does not take its place.
    """
    query = MEALS
    if participant_id is not None:
        query = query.where(Meal.participant_id == participant_id)
    if study_ids is not None:
        query = query.where(Meal.study_id.in_(study_ids))
    if participant_code is not None:
        query = query.where(Participant.code == participant_code)
    return [
        (meal, participant, study)
        for meal, participant, study in session.execute(query, {CLIENT_ID: client_id})
    ]


def versions_of(
    session: Session, meal_ids: Collection[uuid.UUID]
) -> Sequence[sa.Row[uuid.UUID, int]]:
    """Return (id, version) of these meals."""
    return session.execute(sa.select(Meal.id, Meal.version).where(Meal.id.in_(meal_ids))).all()


def set_stage(session: Session, meal_id: uuid.UUID, stage: str) -> None:
    """Set the stage of a meal that is processed; a meal that does not wait is left unchanged."""
    session.execute(
        sa.update(Meal)
        .where(Meal.id == meal_id, Meal.status.in_(WAITING))
        .values(status="processing", stage=stage, version=Meal.version + 1)
    )


def after_windows_over(session: Session, now: datetime, limit: int) -> list[uuid.UUID]:
    """Return meals whose window for an after-meal pair has ended and whose pair does not wait, the oldest first."""
    is_still = sa.or_(Meal.after_status.is_(None), Meal.after_status.not_in(WAITING))
    query = (
        sa.select(Meal.id)
        .where(Meal.after_due_at <= now, is_still)
        .order_by(Meal.after_due_at)
        .limit(limit)
    )
    return list(session.scalars(query))


def oldest_waiting(session: Session) -> datetime | None:
    """Return when the longest waiting job was queued, or queued again; for background jobs nobody waits."""
    query = sa.select(sa.func.min(Job.enqueued_at)).where(Job.state == "queued", ~Job.is_background)
    return session.execute(query).scalar_one()


def first_days(session: Session, participant_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, date]:
    """Return participant -> their first day in the study; absent without a start, a meal or a closed day."""
    first_days: dict[uuid.UUID, date] = {}
    for ids in _batches(participant_ids):
        for participant_id, starts_on, meal, closed in session.execute(
            FIRST_DAYS, {PARTICIPANT_IDS: ids}
        ):
            days = [day for day in (meal, closed) if day is not None]
            if starts_on is not None or days:
                first_days[participant_id] = starts_on or min(days)
    return first_days


def _batches(ids: Collection[uuid.UUID], size: int = 500) -> Iterator[list[uuid.UUID]]:
    """Yield the ids in batches, since the number of a statement's parameters is limited."""
    unique = list(set(ids))
    yield from (unique[start : start + size] for start in range(0, len(unique), size))
