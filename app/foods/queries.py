"""SQL of the food table: the releases in force, foods by key or code, their nutrients, densities and portions.

Several releases may have the same key. Precedence: local corrections, national tables, the starter
table, FoodData Central, SR28, and last the tables that have only densities.
"""

import uuid
from collections.abc import Collection
from dataclasses import dataclass
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session, aliased

from app.foods.models import (
    Component,
    Food,
    FoodActivation,
    FoodDensity,
    FoodNutrient,
    FoodPortion,
    FoodRelease,
    StudyDensity,
)
from app.foods.search.models import FoodCode

T = TypeVar("T")
F = TypeVar("F", int, int | None)

LOCAL = "local"
DENSITIES_ONLY = "fao-density"
OPEN_FOOD_FACTS = "off"
# one code, one food; a FoodEx2 code is a class of foods
SAME_FOOD_SYSTEMS = ("sr28_ndb", "fdc_id", "fndds")
_PRECEDENCE = (LOCAL, "csv", "starter", "fdc", "sr28", OPEN_FOOD_FACTS, DENSITIES_ONLY)


@dataclass(frozen=True, slots=True)
class NutrientRow:
    """One component of a food.

    per_100_g: content of 100 g edible portion, in the component's unit.
    """

    component: Component
    per_100_g: float


def releases_in_force(session: Session) -> list[FoodRelease]:
    """Return the releases in force in order of precedence."""
    newest = sa.select(sa.func.max(FoodActivation.id)).group_by(FoodActivation.name)
    query = (
        sa.select(FoodRelease)
        .join(FoodActivation, FoodActivation.release_id == FoodRelease.id)
        .where(FoodActivation.id.in_(newest))
    )
    return sorted(session.scalars(query), key=_precedence)


def all_releases(session: Session) -> list[FoodRelease]:
    """Return every release, complete or not, the newest import first."""
    return list(session.scalars(sa.select(FoodRelease).order_by(FoodRelease.id.desc())))


def release_by_checksum(
    session: Session, checksum: str, *, lock: bool = False
) -> FoodRelease | None:
    """Return the release made from exactly these files, complete or not; `lock` locks its row until commit."""
    query = sa.select(FoodRelease).where(FoodRelease.checksum == checksum)
    return session.scalars(query.with_for_update() if lock else query).one_or_none()


def foods_by_key(session: Session, keys: Collection[str]) -> dict[str, Food]:
    """Return key -> the food in force, for the keys that exist."""
    order = {release.id: position for position, release in enumerate(releases_in_force(session))}
    query = sa.select(Food).where(
        Food.key.in_(keys), Food.release_id.in_(order), Food.superseded_by_id.is_(None)
    )
    by_key: dict[str, Food] = {}
    for food in sorted(session.scalars(query), key=lambda food: order[food.release_id]):
        by_key.setdefault(food.key, food)
    return by_key


def known_keys(session: Session, keys: Collection[str]) -> set[str]:
    """Return those of the keys that any version of a food has, in force or not."""
    return set(session.scalars(sa.select(Food.key).where(Food.key.in_(keys))))


def foods_by_id(session: Session, ids: Collection[int]) -> list[Food]:
    """Return these versions of foods, in force or not."""
    return list(session.scalars(sa.select(Food).where(Food.id.in_(ids))))


def foods_by_code(session: Session, code: str) -> list[Food]:
    """Return the foods in force with this number in a published table, best first."""
    query = (
        sa.select(FoodCode.code, Food)
        .join(Food, Food.id == FoodCode.food_id)
        .where(FoodCode.code == code, FoodCode.system != "label")
    )
    by_key: dict[str, Food] = {}
    for _, food in _only_in_force(session, query):
        by_key.setdefault(food.key, food)  # a correction replaces what it corrects
    return list(by_key.values())


def same_foods(session: Session, food_ids: Collection[int]) -> dict[int, list[Food]]:
    """Return food id -> other foods in force that share a code of SAME_FOOD_SYSTEMS with it."""
    code, shared_code = aliased(FoodCode), aliased(FoodCode)
    query = (
        sa.select(code.food_id, Food)
        .join(
            shared_code, sa.and_(shared_code.system == code.system, shared_code.code == code.code)
        )
        .join(Food, Food.id == shared_code.food_id)
        .where(
            code.food_id.in_(food_ids),
            code.system.in_(SAME_FOOD_SYSTEMS),
            shared_code.food_id != code.food_id,
        )
    )
    by_id: dict[int, dict[str, Food]] = {food_id: {} for food_id in food_ids}
    for food_id, food in _only_in_force(session, query):
        by_id[food_id].setdefault(food.key, food)
    return {food_id: list(by_key.values()) for food_id, by_key in by_id.items()}


def sources_of(session: Session, release_ids: Collection[int]) -> dict[int, str]:
    """Return release id -> the format that it was read from."""
    query = sa.select(FoodRelease.id, FoodRelease.source).where(FoodRelease.id.in_(release_ids))
    return {row.id: row.source for row in session.execute(query)}


def density_rows(session: Session, labels: Collection[str]) -> list[tuple[str, Food]]:
    """Return the rows in force of tables that have only densities, each with the folded label that it matched."""
    query = (
        sa.select(FoodCode.code, Food)
        .join(Food, Food.id == FoodCode.food_id)
        .where(FoodCode.system == "label", FoodCode.code.in_(labels))
    )
    return list(_only_in_force(session, query))


def densities_of(session: Session, food_ids: Collection[int]) -> dict[int, list[FoodDensity]]:
    """Return food id -> its densities in the table's order."""
    query = (
        sa.select(FoodDensity)
        .where(FoodDensity.food_id.in_(food_ids))
        .order_by(FoodDensity.food_id, FoodDensity.position)
    )
    by_food: dict[int, list[FoodDensity]] = {}
    for density in session.scalars(query):
        by_food.setdefault(density.food_id, []).append(density)
    return by_food


def densities_of_studies(
    session: Session, study_ids: Collection[uuid.UUID], food_key: str
) -> list[StudyDensity]:
    """Return these studies' own measurements of a food, the newest first, without withdrawn ones."""
    query = (
        sa.select(StudyDensity)
        .where(
            StudyDensity.study_id.in_(study_ids),
            StudyDensity.food_key == food_key,
            StudyDensity.withdrawn_at.is_(None),
        )
        .order_by(StudyDensity.measured_at.desc(), StudyDensity.id)
    )
    return list(session.scalars(query))


def nutrients_of(session: Session, food_id: int) -> list[NutrientRow]:
    """Return all known components of a food, in the order of components.csv."""
    return nutrients_of_each(session, [food_id])[food_id]


def nutrients_of_each(session: Session, food_ids: Collection[int]) -> dict[int, list[NutrientRow]]:
    """Return food id -> all its known components, in the order of components.csv."""
    query = (
        sa.select(FoodNutrient.food_id, Component, FoodNutrient.per_100_g)
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(FoodNutrient.food_id.in_(food_ids))
        .order_by(Component.id)
    )
    nutrients: dict[int, list[NutrientRow]] = {food_id: [] for food_id in food_ids}
    for food_id, component, per_100_g in session.execute(query):
        nutrients[food_id].append(NutrientRow(component, per_100_g))
    return nutrients


def contents_of(
    session: Session, food_ids: Collection[F], numbers: Collection[str] | None = None
) -> dict[F, dict[str, float]]:
    """Return food id -> component number -> content of 100 g edible portion; empty for the food id None.

    numbers: only these components; None: all known ones, in the order of components.csv.
    """
    query = (
        sa.select(FoodNutrient.food_id, Component.number, FoodNutrient.per_100_g)
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(FoodNutrient.food_id.in_([food_id for food_id in food_ids if food_id is not None]))
        .order_by(Component.id)
    )
    if numbers is not None:
        query = query.where(Component.number.in_(numbers))
    contents: dict[F, dict[str, float]] = {food_id: {} for food_id in food_ids}
    for food_id, number, per_100_g in session.execute(query):
        contents[food_id][number] = per_100_g
    return contents


def portions_of(session: Session, food_id: int) -> list[FoodPortion]:
    """Return a food's household measures in the source's order."""
    query = (
        sa.select(FoodPortion).where(FoodPortion.food_id == food_id).order_by(FoodPortion.position)
    )
    return list(session.scalars(query))


def components_by_number(session: Session) -> dict[str, Component]:
    """Return number -> component for every component in the database."""
    return {component.number: component for component in session.scalars(sa.select(Component))}


def _only_in_force(session: Session, query: sa.Select[T, Food]) -> list[tuple[T, Food]]:
    """Return the rows whose food is in force, in order of precedence."""
    order = {release.id: position for position, release in enumerate(releases_in_force(session))}
    chosen = query.where(Food.release_id.in_(order), Food.superseded_by_id.is_(None))
    rows = [(value, food) for value, food in session.execute(chosen)]
    return sorted(rows, key=lambda row: (order[row[1].release_id], row[1].id))


def _precedence(release: FoodRelease) -> tuple[int, int]:
    return (_PRECEDENCE.index(release.source), -release.id)
