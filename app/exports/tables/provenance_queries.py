"""SQL of where records come from: the run that measured an item, and who took it for which food, by which density.

A batch of items at a time, as plain values. Which of an item's rows holds follows from rank and version alone, but
where somebody has undone something or changed the items themselves: such meals are named, to be folded.
"""

import uuid
from collections.abc import Collection, Iterable
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, AnyQuery
from app.db.stored_ids import stored_id
from app.exports.tables.record_queries import one_of, rows_of_ids
from app.meals.event_models import MealEvent
from app.meals.models import Meal
from app.meals.record_models import Item, ItemFood, Run

# Behind one of these a row may count no longer, or an item be another one's part (meals/item_state.py).
FOLDED_KINDS = ("undo", "redraw", "add", "split", "merge")


Row = tuple[Any, ...]


def foods_said(session: Session, item_ids: Collection[str]) -> Iterable[Row]:
    """(item, version, layer, density's basis, its sd, edible share): what items are taken for, all rows of each."""
    said = ItemFood
    query = sa.select(
        stored_id(said.item_id),
        said.version,
        said.layer,
        said.density_basis,
        said.density_sd_g_per_ml,
        said.edible_share,
    )
    return _rows(session, query, said.item_id, item_ids)


def runs_of_meals(session: Session, meal_ids: Collection[str]) -> Iterable[Row]:
    """(meal, run, method, pipeline's version): all runs of the meals' own pairs."""
    query = sa.select(stored_id(Run.meal_id), stored_id(Run.id), Run.method, Run.pipeline_version)
    return _rows(session, query.where(Run.purpose == "meal"), Run.meal_id, meal_ids)


def runs_of_items(session: Session, item_ids: Collection[str]) -> dict[str, str | None]:
    """Item -> the run that found it."""
    query = sa.select(stored_id(Item.id), stored_id(Item.run_id))
    return {row[0]: row[1] for row in _rows(session, query, Item.id, item_ids)}


def meals_to_fold(session: Session, meal_ids: Collection[str]) -> list[Meal]:
    """Of these meals the ones of which somebody has said what moves more than one row."""
    query = sa.select(stored_id(MealEvent.meal_id)).distinct().where(MealEvent.kind.in_(FOLDED_KINDS))
    found = [uuid.UUID(row[0]) for row in _rows(session, query, MealEvent.meal_id, meal_ids)]
    return list(session.scalars(sa.select(Meal).where(Meal.id.in_(found)).order_by(Meal.id))) if found else []


def runs_by_id(session: Session, run_ids: Collection[str]) -> dict[str, tuple[str, str]]:
    """Run -> its method and the pipeline's version."""
    query = sa.select(stored_id(Run.id), Run.method, Run.pipeline_version)
    return {run_id: (method, version) for run_id, method, version in _rows(session, query, Run.id, run_ids)}


def _rows(session: Session, query: AnyQuery, column: AnyColumn, ids: Collection[str]) -> Iterable[tuple[Any, ...]]:
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    query = query.where(one_of(column, is_on_sqlite=is_on_sqlite))
    return rows_of_ids(session.connection(), query, ids, is_on_sqlite=is_on_sqlite)
