"""SQL of the food table: the active release, its foods, their nutrients and densities."""

from collections.abc import Collection

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import Component, Food, FoodDensity, FoodNutrient, FoodRelease


def active_release(session: Session) -> FoodRelease | None:
    """The release that new volumes are turned into grams with."""
    return session.scalars(sa.select(FoodRelease).where(FoodRelease.is_active)).one_or_none()


def release_by_checksum(session: Session, checksum: str) -> FoodRelease | None:
    """The release that was made from exactly these files."""
    return session.scalars(sa.select(FoodRelease).where(FoodRelease.checksum == checksum)).one_or_none()


def foods_of(session: Session, release_id: int) -> list[Food]:
    """A release's foods in the table's order."""
    return list(session.scalars(sa.select(Food).where(Food.release_id == release_id).order_by(Food.id)))


def foods_by_key(session: Session, release_id: int, keys: Collection[str]) -> dict[str, Food]:
    """The foods of these keys."""
    query = sa.select(Food).where(Food.release_id == release_id, Food.key.in_(keys))
    return {food.key: food for food in session.scalars(query)}


def densities_of(session: Session, food_id: int) -> list[FoodDensity]:
    """A food's densities in the table's order."""
    query = sa.select(FoodDensity).where(FoodDensity.food_id == food_id).order_by(FoodDensity.position)
    return list(session.scalars(query))


def contents_of(session: Session, food_id: int) -> dict[str, float]:
    """Tagname to content of 100 g edible portion."""
    query = sa.select(FoodNutrient.tagname, FoodNutrient.per_100_g).where(FoodNutrient.food_id == food_id)
    return {row.tagname: row.per_100_g for row in session.execute(query)}


def known_components(session: Session) -> set[str]:
    """Tagnames that are there."""
    return set(session.scalars(sa.select(Component.tagname)))
