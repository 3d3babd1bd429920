"""The active food table for readers: search, one food with all that is known of it."""

from collections.abc import Sequence
from dataclasses import dataclass

from app.db.models import Food, FoodDensity
from app.db.queries import foods, records
from app.db.session import Database
from app.errors import NotFoundError
from app.nutrition.search import rank_labels


@dataclass(frozen=True, slots=True)
class FoodView:
    """A food with its densities, nutrients (tagname, name, unit, per 100 g edible) and the release it is of."""

    food: Food
    release: str
    densities: Sequence[FoodDensity]
    nutrients: Sequence[tuple[str, str, str, float]]


def search_foods(database: Database, words: str | None = None, limit: int = 50) -> list[Food]:
    """Foods of the active release, best match first; without words, in the table's order."""
    with database.read() as session:
        release = foods.active_release(session)
        rows = foods.foods_of(session, release.id) if release is not None else []
    if words is None:
        return rows[:limit]
    labels = [(row.name, *row.aliases, row.key) for row in rows]
    return [rows[position] for position in rank_labels(labels, words)][:limit]


def read_food(database: Database, key: str) -> FoodView:
    """One food of the active release. Raises NotFoundError."""
    with database.read() as session:
        release = foods.active_release(session)
        found = foods.foods_by_key(session, release.id, [key]) if release is not None else {}
        if release is None or key not in found:
            raise NotFoundError(f"The food table has no food {key!r}: search it for the key.", code="food_not_found")
        return FoodView(
            food=found[key],
            release=f"{release.name} {release.version}",
            densities=foods.densities_of(session, found[key].id),
            nutrients=records.nutrients_of(session, found[key].id),
        )
