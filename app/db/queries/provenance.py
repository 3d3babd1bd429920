"""SQL of where records come from: the run that measured an item, and who took it for which food, by which density.

A batch of items at a time, as plain values. Which of an item's rows holds follows from rank and version alone, but
where somebody has undone something or changed the items themselves: such meals are named, to be folded.
"""

import uuid
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import Item, ItemFood, Meal, MealEvent, Run
from app.db.queries.record_export import one_of, rows_of_ids, stored_id

# Behind one of these a row may count no longer, or an item be another one's part (services/item_state.py).
FOLDED_KINDS = ("undo", "redraw", "add", "split", "merge")


class FoodSaid(NamedTuple):
    """A row of item_food: what an item is taken for; all None where nobody has said it."""

    layer: str | None
    version: int | None
    food_id: int | None
    density_basis: str | None
    density_sd_g_per_ml: float | None
    edible_share: float | None


class ItemOrigin(NamedTuple):
    """An item's run, as text, and one of the rows of what it is taken for. Items without such a row come once."""

    item_id: str
    run_id: str | None
    said: FoodSaid


def origins_of(session: Session, item_ids: Collection[str]) -> Iterable[ItemOrigin]:
    """Of each item all rows. Ids are text, as the database has it."""
    said = ItemFood
    query = (
        sa.select(
            stored_id(Item.id),
            stored_id(Item.run_id),
            said.layer,
            said.version,
            said.food_id,
            said.density_basis,
            said.density_sd_g_per_ml,
            said.edible_share,
        )
        .select_from(Item)
        .outerjoin(said, said.item_id == Item.id)
    )
    return (ItemOrigin(row[0], row[1], FoodSaid(*row[2:])) for row in _rows(session, query, Item.id, item_ids))


def meals_to_fold(session: Session, meal_ids: Collection[str]) -> list[Meal]:
    """Of these meals the ones of which somebody has said what moves more than one row."""
    query = sa.select(stored_id(MealEvent.meal_id)).distinct().where(MealEvent.kind.in_(FOLDED_KINDS))
    found = [uuid.UUID(row[0]) for row in _rows(session, query, MealEvent.meal_id, meal_ids)]
    return list(session.scalars(sa.select(Meal).where(Meal.id.in_(found)).order_by(Meal.id))) if found else []


def runs_by_id(session: Session, run_ids: Collection[str]) -> dict[str, tuple[str, str]]:
    """Run -> its method and the pipeline's version."""
    query = sa.select(stored_id(Run.id), Run.method, Run.pipeline_version)
    return {run_id: (method, version) for run_id, method, version in _rows(session, query, Run.id, run_ids)}


def _rows(
    session: Session, query: sa.Select[*tuple[Any, ...]], column: Any, ids: Collection[str]
) -> Iterable[tuple[Any, ...]]:
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    query = query.where(one_of(column, is_on_sqlite=is_on_sqlite))
    return rows_of_ids(session.connection(), query, ids, is_on_sqlite=is_on_sqlite)
