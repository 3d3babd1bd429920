"""Provenance of exported records: the run, who assigned the food, and the kind of density behind the mass.

A batch of items at a time, as plain values. Which of an item's rows counts follows from layer and version alone, unless
an event of FOLDED_KINDS was sent: such meals are folded.
"""

import uuid
from collections.abc import Collection, Mapping, Sequence

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, AnyQuery
from app.db.stored_ids import stored_id
from app.exports.tables.record_queries import Keys, Lookup, Rows, hyphenated, one_of, rows_of_ids, spellings
from app.http.tables.columns import Cell, Part
from app.http.tables.record_columns import OF_RUN, OF_WEIGHING
from app.meals.event_models import LAYERS, MealEvent
from app.meals.item_state import fold_meal
from app.meals.meal_parts import parts_of
from app.meals.models import Meal
from app.meals.record_models import EffectiveRecord, ItemFood, Run

# After one of these events a row may no longer count, or an item may be part of another (meals/item_state.py).
FOLDED_KINDS = ("undo", "redraw", "add", "split", "merge")
NO_RUN = (None, None, None)
NO_FOOD = (None, None, None, None)
RANKS: dict[Cell, int] = {layer: rank for rank, layer in enumerate(LAYERS)}
SEEN = "pipeline"  # the origin of items that a run found in the meal's pair

Values = tuple[Cell, ...]  # the values of OF_RUN, or of OF_WEIGHING


class Provenance:
    """Gives the rows of OF_RUN and OF_WEIGHING of a batch of records; caches runs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._spelling = 1 if session.get_bind().dialect.name == "sqlite" else 0  # the database's form of ids
        self._runs = Lookup(lambda ids: {key: (hyphenated(key), *of) for key, of in _runs_by_id(session, ids).items()})

    def __call__(self, keys: Keys) -> Mapping[Part, Sequence[Values]]:
        """Return the records' rows in order: most follow from their own rows, the others from folding their meals."""
        weighed = self._weighings(keys.item_ids)
        ran, others = self._runs_of_items(keys)
        for item_id, run, weighing in self._folded(keys.meal_ids):
            others[item_id] = run
            weighed[item_id] = weighing
        of_run: list[Values] = [
            ran.get(meal_id, NO_RUN) if origin == SEEN else NO_RUN
            for meal_id, origin in zip(keys.meal_ids, keys.origins, strict=True)
        ]
        if others:
            of_run = [others.get(item_id, run) for item_id, run in zip(keys.item_ids, of_run, strict=True)]
        of_items = [weighed.get(item_id, NO_FOOD) for item_id in keys.item_ids]
        return {
            OF_RUN: of_run,
            OF_WEIGHING: [
                weighing if density is not None else (weighing[0], None, None, weighing[3])
                for weighing, density in zip(of_items, keys.densities_g_per_ml, strict=True)
            ],
        }

    def _weighings(self, item_ids: Sequence[str]) -> dict[str, Values]:
        """Return item -> its newest row of the highest layer."""
        newest: dict[str, Values] = {}
        for row in _assignments_of_items(self._session, item_ids):
            best = newest.setdefault(row[0], row)
            if best is not row and (RANKS[row[2]], row[1]) > (RANKS[best[2]], best[1]):
                newest[row[0]] = row
        return {item_id: row[2:] for item_id, row in newest.items()}

    def _runs_of_items(self, keys: Keys) -> tuple[dict[str, Values], dict[str, Values]]:
        """Return meal -> its run, and item -> the run that saw its region, for meals with several runs."""
        ran: dict[str, Values] = {}
        several: set[str] = set()
        for meal_id, run_id, method, version in _runs_of_meals(self._session, set(keys.meal_ids)):
            if meal_id in ran:
                several.add(meal_id)
            ran[meal_id] = (hyphenated(run_id), method, version)
        if not several:
            return ran, {}
        of_several = [item for item, meal in zip(keys.item_ids, keys.meal_ids, strict=True) if meal in several]
        found_by = _runs_of_items(self._session, of_several)
        return ran, {item_id: self._run(run_id) for item_id, run_id in found_by.items()}

    def _folded(self, meal_ids: Sequence[str]) -> list[tuple[str, Values, Values]]:
        """Return (item, its run, its weighing) for meals with an event of FOLDED_KINDS."""
        meals = _meals_to_fold(self._session, set(meal_ids))
        folded: list[tuple[str, Values, Values]] = []
        for parts in parts_of(self._session, meals) if meals else ():
            for state in fold_meal(parts).items:
                run_id = spellings(state.run_id)[self._spelling] if state.run_id is not None else None
                item_id = spellings(state.item.id)[self._spelling]
                folded.append((item_id, self._run(run_id), _weighing(state.food_assignment)))
        return folded

    def _run(self, run_id: str | None) -> Values:
        return self._runs([run_id])[0] if run_id is not None else NO_RUN


def _weighing(row: ItemFood | None) -> Values:
    return (row.layer, row.density_basis, row.density_sd_g_per_ml, row.edible_share) if row is not None else NO_FOOD


def _assignments_of_items(session: Session, item_ids: Collection[str]) -> Rows:
    """Return (item, version, layer, density basis, density sd, edible share) of all food assignments of the items."""
    query = sa.select(
        stored_id(ItemFood.item_id),
        ItemFood.version,
        ItemFood.layer,
        ItemFood.density_basis,
        ItemFood.density_sd_g_per_ml,
        ItemFood.edible_share,
    )
    return _rows(session, query, ItemFood.item_id, item_ids)


def _runs_of_meals(session: Session, meal_ids: Collection[str]) -> Rows:
    """Return (meal, run, method, pipeline's version): all runs of the meals' own pairs."""
    query = sa.select(stored_id(Run.meal_id), stored_id(Run.id), Run.method, Run.pipeline_version)
    return _rows(session, query.where(Run.purpose == "meal"), Run.meal_id, meal_ids)


def _runs_of_items(session: Session, item_ids: Collection[str]) -> dict[str, str | None]:
    """Return item -> the run that saw its current region."""
    query = sa.select(stored_id(EffectiveRecord.item_id), stored_id(EffectiveRecord.run_id))
    return {row[0]: row[1] for row in _rows(session, query, EffectiveRecord.item_id, item_ids)}


def _meals_to_fold(session: Session, meal_ids: Collection[str]) -> list[Meal]:
    """Return the meals with an event of FOLDED_KINDS."""
    query = sa.select(stored_id(MealEvent.meal_id)).distinct().where(MealEvent.kind.in_(FOLDED_KINDS))
    matched_ids = [uuid.UUID(row[0]) for row in _rows(session, query, MealEvent.meal_id, meal_ids)]
    return (
        list(session.scalars(sa.select(Meal).where(Meal.id.in_(matched_ids)).order_by(Meal.id))) if matched_ids else []
    )


def _runs_by_id(session: Session, run_ids: Collection[str]) -> dict[str, tuple[str, str]]:
    """Return run -> its method and pipeline version."""
    query = sa.select(stored_id(Run.id), Run.method, Run.pipeline_version)
    return {run_id: (method, version) for run_id, method, version in _rows(session, query, Run.id, run_ids)}


def _rows(session: Session, query: AnyQuery, column: AnyColumn, ids: Collection[str]) -> Rows:
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    query = query.where(one_of(column, is_on_sqlite=is_on_sqlite))
    return rows_of_ids(session.connection(), query, ids, is_on_sqlite=is_on_sqlite)
