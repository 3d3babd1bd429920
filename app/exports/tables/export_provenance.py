"""Provenance of exported records: the run, who assigned the food, and the kind of density behind the mass.

A record names the run that saw its region and the version of its food assignment that counts: their rows are looked up
a batch at a time, as plain values.
"""

from collections.abc import Collection
from itertools import repeat

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, AnyQuery
from app.db.stored_ids import stored_id
from app.exports.tables.record_queries import Keys, Lookup, Rows, hyphenated, one_of, rows_of_ids
from app.http.tables.columns import Batch, Cell, PartOfBatch, distinct
from app.http.tables.record_columns import OF_RUN, OF_WEIGHING
from app.meals.record_models import ItemFood, Run

NO_RUN = (None, None, None)
NO_FOOD = (None, None, None, None)

Values = tuple[Cell, ...]  # the values of OF_RUN, or of OF_WEIGHING


class Provenance:
    """Gives the rows of OF_RUN and OF_WEIGHING of a batch of records; caches runs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._runs = Lookup(lambda ids: _runs(session, ids))

    def __call__(self, keys: Keys) -> Batch:
        """Return OF_RUN and OF_WEIGHING of these records. Raises KeyError for a record whose run is missing."""
        numbered = list(zip(keys.item_ids, keys.food_versions, strict=True))
        assignments = _assignments(self._session, [item_id for item_id, version in numbered if version is not None])
        run_ids, places = distinct(keys.run_ids)
        return [
            PartOfBatch(OF_RUN, self._runs(run_ids), places),
            PartOfBatch(
                OF_WEIGHING,
                [
                    values if density is not None else (values[0], None, None, values[3])
                    for values, density in zip(
                        map(assignments.get, numbered, repeat(NO_FOOD)), keys.densities_g_per_ml, strict=True
                    )
                ],
            ),
        ]


def _assignments(session: Session, item_ids: Collection[str]) -> dict[tuple[str, int | None], Values]:
    """Return (item, version) -> layer, density basis, density sd, edible share of all food assignments of the items."""
    query = sa.select(
        stored_id(ItemFood.item_id),
        ItemFood.version,
        ItemFood.layer,
        ItemFood.density_basis,
        ItemFood.density_sd_g_per_ml,
        ItemFood.edible_share,
    )
    return {(row[0], row[1]): row[2:] for row in _rows(session, query, ItemFood.item_id, item_ids)}


def _runs(session: Session, run_ids: Collection[str | None]) -> dict[str | None, Values]:
    """Return run -> its id with hyphens, its method and its pipeline version."""
    query = sa.select(stored_id(Run.id), Run.method, Run.pipeline_version)
    rows = _rows(session, query, Run.id, [each for each in run_ids if each is not None])
    ids = [row[0] for row in rows]
    return {None: NO_RUN} | {
        run_id: (text, *row[1:]) for run_id, text, row in zip(ids, hyphenated(ids), rows, strict=True)
    }


def _rows(session: Session, query: AnyQuery, column: AnyColumn, ids: Collection[str]) -> Rows:
    if not ids:
        return ()
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    query = query.where(one_of(column, is_on_sqlite=is_on_sqlite))
    return rows_of_ids(session.connection(), query, ids, is_on_sqlite=is_on_sqlite)
