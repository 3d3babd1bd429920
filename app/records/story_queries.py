"""SQL of a meal's story beside its events: all its runs, jobs that ended without one, recomputations of its foods."""

import uuid

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.job_models import Job
from app.meals.record_models import Item, ItemFood, Recompute, Run


def runs_of(session: Session, meal_id: uuid.UUID) -> list[Run]:
    """All runs of a meal, of whatever purpose, the oldest first."""
    return list(session.scalars(sa.select(Run).where(Run.meal_id == meal_id).order_by(Run.created_at, Run.id)))


def jobs_of(session: Session, meal_id: uuid.UUID) -> list[Job]:
    """All jobs of a meal, the oldest first. A run has its job's id."""
    return list(session.scalars(sa.select(Job).where(Job.meal_id == meal_id).order_by(Job.enqueued_at, Job.id)))


def recomputes_of(session: Session, meal_id: uuid.UUID) -> list[Recompute]:
    """Recomputations that gave an item of the meal another food version, density or edible share."""
    ids = (
        sa.select(ItemFood.recompute_id)
        .join(Item, Item.id == ItemFood.item_id)
        .where(Item.meal_id == meal_id, ItemFood.recompute_id.is_not(None))
    )
    return list(session.scalars(sa.select(Recompute).where(Recompute.id.in_(ids)).order_by(Recompute.started_at)))
