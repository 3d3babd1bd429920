"""SQL of double review: items to decide, and who decided which."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import Condition
from app.foods.models import Food
from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Participant, Staff, Study
from app.records.double_review.drawn import is_blind
from app.records.review.queries import QueueRow

STANDS = ReviewDecision.undone_at.is_(None)


def blind_row(session: Session, study: Study, *conditions: Condition) -> QueueRow | None:
    """Return the first item, by its meal's time, that two decide and that is not settled."""
    record = EffectiveRecord
    query = (
        sa.select(record, Meal, Participant.code, Food, Item)
        .join(Meal, Meal.id == record.meal_id)
        .join(Item, Item.id == record.item_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(Food, Food.id == record.food_id)
        .where(record.study_id == study.id, is_blind(study), *conditions)
        .order_by(record.captured_at, record.item_id)
        .limit(1)
    )
    row = session.execute(query).one_or_none()
    return QueueRow(*row) if row is not None else None


@dataclass(frozen=True, slots=True)
class MadeDecision:
    """A decision that stands, who made it, and what it is of: an item of a meal, or a known one."""

    decision: ReviewDecision
    reviewer: str
    meal: Meal | None
    participant: str | None
    known: KnownItem | None


def made_decisions(session: Session, condition: Condition) -> list[MadeDecision]:
    """Return decisions item by item, a third's last, those before by the reviewers' names."""
    decision = ReviewDecision
    query = (
        sa.select(decision, Staff.name, Meal, Participant.code, KnownItem)
        .join(Staff, Staff.id == decision.staff_id)
        .outerjoin(Meal, Meal.id == decision.meal_id)
        .outerjoin(Participant, Participant.id == Meal.participant_id)
        .outerjoin(KnownItem, KnownItem.id == decision.item_id)
        .where(condition, STANDS)
        .order_by(decision.item_id, decision.is_final, Staff.name)
    )
    return [MadeDecision(*row) for row in session.execute(query)]


def decided_items(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> set[uuid.UUID]:
    """Return the items that a reviewer has decided, known ones too."""
    query = sa.select(ReviewDecision.item_id).where(
        ReviewDecision.study_id == study_id, ReviewDecision.staff_id == staff_id, STANDS
    )
    return set(session.scalars(query))


def known_items(session: Session, study_id: uuid.UUID) -> Sequence[KnownItem]:
    """Return a study's items with a known answer, by id."""
    query = sa.select(KnownItem).where(KnownItem.study_id == study_id)
    return session.scalars(query.order_by(KnownItem.id)).all()


def like_foods(session: Session, food: Food, limit: int) -> Sequence[Food]:
    """Return other foods of the same release and group."""
    query = sa.select(Food).where(
        Food.release_id == food.release_id,
        Food.food_group == food.food_group,
        Food.key != food.key,
        Food.superseded_by_id.is_(None),
    )
    return session.scalars(query.order_by(Food.key).limit(limit)).all()
