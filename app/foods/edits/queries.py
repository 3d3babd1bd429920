"""SQL of corrections: the versions of a food, the ingredients of a dish, a study's own densities."""

import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session, aliased

from app.foods.models import Food, FoodChange, FoodIngredient, FoodRelease, StudyDensity
from app.foods.queries import LOCAL


@dataclass(frozen=True, slots=True)
class Change:
    """A version of a food created here; previous: the version that it corrects, None for a new food."""

    food: Food
    change: FoodChange
    previous: Food | None
    previous_release: FoodRelease | None


def local_release(session: Session) -> FoodRelease | None:
    """Return the release that corrections are written to; None before the first one."""
    return session.scalars(sa.select(FoodRelease).where(FoodRelease.source == LOCAL)).one_or_none()


def changes_of(session: Session, key: str) -> list[Change]:
    """Return the versions of a food that were created here, the newest first."""
    previous, release = aliased(Food), aliased(FoodRelease)
    query = (
        sa.select(Food, FoodChange, previous, release)
        .join(FoodChange, FoodChange.food_id == Food.id)
        .outerjoin(previous, previous.id == FoodChange.previous_id)
        .outerjoin(release, release.id == previous.release_id)
        .where(Food.key == key)
        .order_by(Food.version.desc())
    )
    return [Change(*row) for row in session.execute(query)]


def ingredients_of(session: Session, food_id: int) -> list[tuple[FoodIngredient, Food]]:
    """Return the ingredients of a dish in the recipe's order, each with its version of the food."""
    query = (
        sa.select(FoodIngredient, Food)
        .join(Food, Food.id == FoodIngredient.ingredient_id)
        .where(FoodIngredient.food_id == food_id)
        .order_by(FoodIngredient.position)
    )
    return [(ingredient, food) for ingredient, food in session.execute(query)]


def parts_of(session: Session, food_ids: Collection[int]) -> dict[str, set[str]]:
    """Return food key -> keys of its ingredients, for these versions and, recursively, their ingredients."""
    dish, part = aliased(Food), aliased(Food)
    parts: dict[str, set[str]] = {}
    visited: set[int] = set()
    ids = set(food_ids)
    while ids:
        visited |= ids
        query = (
            sa.select(dish.key, part.key, part.id)
            .select_from(FoodIngredient)
            .join(dish, dish.id == FoodIngredient.food_id)
            .join(part, part.id == FoodIngredient.ingredient_id)
            .where(FoodIngredient.food_id.in_(ids))
        )
        ids = set()
        for dish_key, part_key, part_id in session.execute(query):
            parts.setdefault(dish_key, set()).add(part_key)
            ids.add(part_id)
        ids -= visited
    return parts


def all_study_densities(
    session: Session, study_id: uuid.UUID, food_key: str | None
) -> list[StudyDensity]:
    """Return a study's own measurements, withdrawn ones too, the newest entry first."""
    query = sa.select(StudyDensity).where(StudyDensity.study_id == study_id)
    if food_key is not None:
        query = query.where(StudyDensity.food_key == food_key)
    return list(session.scalars(query.order_by(StudyDensity.created_at.desc(), StudyDensity.id)))


def withdraw(
    session: Session,
    study_id: uuid.UUID,
    density_id: uuid.UUID,
    author: str,
    reason: str,
    at: datetime,
) -> bool:
    """Withdraw a study's measurement; return False if it does not exist or is withdrawn.

    One of two callers wins.
    """
    query = (
        sa.update(StudyDensity)
        .where(
            StudyDensity.id == density_id,
            StudyDensity.study_id == study_id,
            StudyDensity.withdrawn_at.is_(None),
        )
        .values(withdrawn_by=author, withdrawn_at=at, withdrawal_reason=reason)
        .returning(StudyDensity.id)
    )
    return session.execute(query).scalar_one_or_none() is not None


@dataclass(frozen=True, slots=True)
class FoodVersion:
    """A version of a food and its release."""

    food: Food
    release: FoodRelease


def versions_of(session: Session, key: str) -> list[FoodVersion]:
    """Return all versions of a food in complete releases, in force or not, the newest release and version first."""
    query = (
        sa.select(Food, FoodRelease)
        .join(FoodRelease, FoodRelease.id == Food.release_id)
        .where(Food.key == key, FoodRelease.completed_at.is_not(None))
        .order_by(FoodRelease.id.desc(), Food.version.desc())
    )
    return [FoodVersion(*row) for row in session.execute(query)]
