"""SQL of the components that the foods of some studies' records have."""

import uuid
from collections.abc import Collection, Sequence

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import (
    Component,
    Food,
    FoodNutrient,
)
from app.meals.record_models import EffectiveRecord


def components_in_use(session: Session, study_ids: Collection[uuid.UUID] | None) -> Sequence[Component]:
    """Those that a food in use is known to have, in the order of components.csv. study_ids: None, all studies'.

    A food is looked for in the records by its index, once, however many records there are.
    """
    record = EffectiveRecord
    first = sa.select(record.food_id).where(record.food_id == Food.id).limit(1)
    if study_ids is not None:
        first = first.where(record.study_id.in_(study_ids))
    used = sa.select(Food.id).where(first.correlate(Food).scalar_subquery().is_not(None))
    known = sa.select(FoodNutrient.component_id).where(FoodNutrient.food_id.in_(used))
    return session.scalars(sa.select(Component).where(Component.id.in_(known)).order_by(Component.id)).all()
