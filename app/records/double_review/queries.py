"""SQL of double review: items to decide, and who decided which."""

import uuid
from collections.abc import Collection, Sequence
from itertools import groupby

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import Condition
from app.foods.models import Food
from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Participant, Staff, Study
from app.records.double_review.drawn import is_blind
from app.records.double_review.schemas import DecisionOut
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


def decisions_of(session: Session, item_id: uuid.UUID) -> list[tuple[ReviewDecision, str]]:
    """Return (decision, reviewer's name) of an item, the oldest first."""
    query = sa.select(ReviewDecision, Staff.name).join(Staff).order_by(ReviewDecision.decided_at)
    rows = session.execute(query.where(ReviewDecision.item_id == item_id, STANDS))
    return [(decision, name) for decision, name in rows]


def decided_by_two(session: Session, study_id: uuid.UUID) -> list[list[DecisionOut]]:
    """Return the decisions about each item that two have decided, by name, a third's last."""
    decision = ReviewDecision
    query = (
        sa.select(
            *(decision.item_id.label("item"), Meal.client_id.label("meal"), Meal.local_date),
            *(Participant.code.label("participant"), Staff.name.label("reviewer")),
            *(decision.is_final, decision.food_key, decision.mass_g),
            *(decision.energy_kcal, decision.decided_at, decision.settled_at),
        )
        .join(Staff, Staff.id == decision.staff_id)
        .join(Meal, Meal.id == decision.meal_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(decision.study_id == study_id, STANDS)
        .order_by(decision.item_id, decision.is_final, Staff.name)
    )
    rows = [DecisionOut.model_validate(row) for row in session.execute(query).mappings()]
    items = [list(group) for _, group in groupby(rows, key=lambda row: row.item)]
    return [decisions for decisions in items if len(decisions) > 1]


def known_decisions(
    session: Session, study_id: uuid.UUID
) -> list[tuple[str, ReviewDecision, KnownItem]]:
    """Return (reviewer, decision, known item) of a study."""
    query = (
        sa.select(Staff.name, ReviewDecision, KnownItem)
        .join(ReviewDecision, ReviewDecision.staff_id == Staff.id)
        .join(KnownItem, KnownItem.id == ReviewDecision.item_id)
        .where(KnownItem.study_id == study_id, STANDS)
    )
    return [(name, decision, known) for name, decision, known in session.execute(query)]


def decided_items(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> set[uuid.UUID]:
    """Return the items that a reviewer has decided, known ones too."""
    query = sa.select(ReviewDecision.item_id).where(
        ReviewDecision.study_id == study_id, ReviewDecision.staff_id == staff_id, STANDS
    )
    return set(session.scalars(query))


def known_item(
    session: Session, study_id: uuid.UUID, without: Collection[uuid.UUID]
) -> KnownItem | None:
    """Return the first of a study's items with a known answer, by id, but for these."""
    query = sa.select(KnownItem).where(KnownItem.study_id == study_id, KnownItem.id.not_in(without))
    return session.scalars(query.order_by(KnownItem.id).limit(1)).one_or_none()


def like_foods(session: Session, food: Food, limit: int) -> Sequence[Food]:
    """Return other foods of the same release and group."""
    query = sa.select(Food).where(
        Food.release_id == food.release_id,
        Food.food_group == food.food_group,
        Food.key != food.key,
        Food.superseded_by_id.is_(None),
    )
    return session.scalars(query.order_by(Food.key).limit(limit)).all()
