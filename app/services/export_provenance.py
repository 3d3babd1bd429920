"""Where each exported record comes from: its run, who said what it is, what kind of density weighed it."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.db.models import ItemFood
from app.db.models.review import LAYERS
from app.db.queries.meal_parts import parts_of
from app.db.queries.provenance import FoodSaid, meals_to_fold, origins_of, runs_by_id
from app.db.queries.record_export import Keys, Lookup, hyphenated, spellings
from app.exports.columns import Part
from app.exports.record_columns import OF_RUN, OF_WEIGHING
from app.services.item_state import fold_meal

NOT_SAID = FoodSaid(None, None, None, None, None, None)
NO_RUN = (None, None, None)
RANKS = {layer: rank for rank, layer in enumerate(LAYERS)}


class Provenance:
    """Gives the rows of OF_RUN and OF_WEIGHING of a batch of records; keeps what it has learnt of runs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._spelling = 1 if session.get_bind().dialect.name == "sqlite" else 0  # as the database tells ids
        self._runs = Lookup(lambda ids: runs_by_id(session, ids))

    def __call__(self, keys: Keys) -> Mapping[Part, Sequence[Any]]:
        """Of these records, in their order."""
        found = self._of_items(keys)
        of_items = [found[item_id] for item_id in keys.item_ids]
        run_ids = [run_id for run_id, _ in of_items if run_id is not None]
        runs = dict(zip(run_ids, self._runs(run_ids), strict=True))
        return {
            OF_RUN: [(hyphenated(run_id), *runs[run_id]) if run_id is not None else NO_RUN for run_id, _ in of_items],
            OF_WEIGHING: [
                (
                    said.layer,
                    said.density_basis if density is not None else None,
                    said.density_sd_g_per_ml if density is not None else None,
                    said.edible_share,
                )
                for (_, said), density in zip(of_items, keys.densities_g_per_ml, strict=True)
            ],
        }

    def _of_items(self, keys: Keys) -> dict[str, tuple[str | None, FoodSaid]]:
        """Item -> its run and the row that holds: the newest of the highest layer, unless the meal must be folded."""
        found: dict[str, tuple[str | None, FoodSaid]] = {}
        for origin in origins_of(self._session, keys.item_ids):
            known = found.get(origin.item_id)
            if known is None or _rank(origin.said) > _rank(known[1]):
                found[origin.item_id] = (origin.run_id, origin.said)
        return found | self._folded(keys.meal_ids)

    def _folded(self, meal_ids: Sequence[str]) -> dict[str, tuple[str | None, FoodSaid]]:
        """The same of items of meals of which more was said than what they are and how much."""
        meals = meals_to_fold(self._session, set(meal_ids))
        folded: dict[str, tuple[str | None, FoodSaid]] = {}
        for parts in parts_of(self._session, meals) if meals else ():
            for state in fold_meal(parts).items:
                run_id = spellings(state.run_id)[self._spelling] if state.run_id is not None else None
                folded[spellings(state.item.id)[self._spelling]] = (run_id, _said(state.taken_for))
        return folded


def _said(row: ItemFood | None) -> FoodSaid:
    if row is None:
        return NOT_SAID
    return FoodSaid(row.layer, row.version, row.food_id, row.density_basis, row.density_sd_g_per_ml, row.edible_share)


def _rank(said: FoodSaid) -> tuple[int, int]:
    return (RANKS[said.layer], said.version or 0) if said.layer is not None else (-1, 0)
