"""List foods for browsing: search results, each with its energy and its density."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.db.session import Database
from app.foods import queries as foods
from app.foods.food_values import bare_value, pooled_densities
from app.foods.models import Food
from app.foods.search.search_foods import MatchedFood, search_foods
from app.nutrition.components import ENERGY_NUMBERS
from app.nutrition.density import resolve_density
from app.nutrition.foods import Density

FOODS_AT_ONCE = 100  # foods per statement


@dataclass(frozen=True, slots=True)
class ListedFood:
    """A matched food. energy_kcal: of 100 g edible portion; density: the chosen one. None: not known."""

    food: MatchedFood
    energy_kcal: float | None
    density: Density | None


def list_foods(
    database: Database, words: str | None = None, *, group: str | None = None, limit: int = 50
) -> list[ListedFood]:
    """Return the results of search_foods in their order, each with the energy and density that read_food returns."""
    matches = search_foods(database, words, group=group, limit=limit)
    keys = [food.key for food in matches]
    figures: dict[str, tuple[float | None, Density | None]] = {}
    with database.read() as session:
        for start in range(0, len(keys), FOODS_AT_ONCE):
            rows = list(foods.foods_by_key(session, keys[start : start + FOODS_AT_ONCE]).values())
            figures |= dict(_figures(session, rows))
    return [ListedFood(food, *figures.get(food.key, (None, None))) for food in matches]


def _figures(
    session: Session, rows: Sequence[Food]
) -> Iterator[tuple[str, tuple[float | None, Density | None]]]:
    densities = pooled_densities(session, rows)
    contents = foods.contents_of(session, [row.id for row in rows], ENERGY_NUMBERS)
    for row in rows:
        energy = next(
            (contents[row.id][number] for number in ENERGY_NUMBERS if number in contents[row.id]),
            None,
        )
        choice = resolve_density(replace(bare_value(row), densities=densities[row.id]))
        yield row.key, (energy, choice.chosen if choice is not None else None)
