"""Where each exported record comes from: its run, who said what it is, what kind of density weighed it."""

from collections.abc import Mapping, Sequence

from sqlalchemy.orm import Session

from app.exports.tables.provenance_queries import foods_said, meals_to_fold, runs_by_id, runs_of_items, runs_of_meals
from app.exports.tables.record_queries import Keys, Lookup, hyphenated, spellings
from app.http.tables.columns import Cell, Part
from app.http.tables.record_columns import OF_RUN, OF_WEIGHING
from app.meals.event_models import LAYERS
from app.meals.item_state import fold_meal
from app.meals.meal_parts import parts_of
from app.meals.record_models import ItemFood

NO_RUN = (None, None, None)
NOT_SAID = (None, None, None, None)
RANKS: dict[Cell, int] = {layer: rank for rank, layer in enumerate(LAYERS)}
SEEN = "pipeline"  # the origin of items that a run found in the meal's pair

Told = tuple[Cell, ...]  # the values of OF_RUN, or of OF_WEIGHING


class Provenance:
    """Gives the rows of OF_RUN and OF_WEIGHING of a batch of records; keeps what it has learnt of runs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._spelling = 1 if session.get_bind().dialect.name == "sqlite" else 0  # as the database tells ids
        self._runs = Lookup(lambda ids: {key: (hyphenated(key), *of) for key, of in runs_by_id(session, ids).items()})

    def __call__(self, keys: Keys) -> Mapping[Part, Sequence[Told]]:
        """Of these records, in their order. Most follow from their own rows; the rest from folding their meals."""
        weighed = self._weighings(keys.item_ids)
        ran, others = self._runs_of_items(keys)
        for item_id, run, weighing in self._folded(keys.meal_ids):
            others[item_id] = run
            weighed[item_id] = weighing
        of_run: list[Told] = [
            ran.get(meal_id, NO_RUN) if origin == SEEN else NO_RUN
            for meal_id, origin in zip(keys.meal_ids, keys.origins, strict=True)
        ]
        if others:
            of_run = [others.get(item_id, run) for item_id, run in zip(keys.item_ids, of_run, strict=True)]
        of_items = [weighed.get(item_id, NOT_SAID) for item_id in keys.item_ids]
        return {
            OF_RUN: of_run,
            OF_WEIGHING: [
                told if density is not None else (told[0], None, None, told[3])
                for told, density in zip(of_items, keys.densities_g_per_ml, strict=True)
            ],
        }

    def _weighings(self, item_ids: Sequence[str]) -> dict[str, Told]:
        """Item -> what its newest row of the highest layer tells."""
        newest: dict[str, Told] = {}
        for row in foods_said(self._session, item_ids):
            known = newest.setdefault(row[0], row)
            if known is not row and (RANKS[row[2]], row[1]) > (RANKS[known[2]], known[1]):
                newest[row[0]] = row
        return {item_id: row[2:] for item_id, row in newest.items()}

    def _runs_of_items(self, keys: Keys) -> tuple[dict[str, Told], dict[str, Told]]:
        """Meal -> its run; item -> the run that found it, of meals that have several."""
        ran: dict[str, Told] = {}
        several: set[str] = set()
        for meal_id, run_id, method, version in runs_of_meals(self._session, set(keys.meal_ids)):
            if meal_id in ran:
                several.add(meal_id)
            ran[meal_id] = (hyphenated(run_id), method, version)
        if not several:
            return ran, {}
        of_several = [item for item, meal in zip(keys.item_ids, keys.meal_ids, strict=True) if meal in several]
        found = runs_of_items(self._session, of_several)
        return ran, {item_id: self._run(run_id) for item_id, run_id in found.items()}

    def _folded(self, meal_ids: Sequence[str]) -> list[tuple[str, Told, Told]]:
        """(item, its run, its weighing) of meals of which more was said than what items are and how much."""
        meals = meals_to_fold(self._session, set(meal_ids))
        folded: list[tuple[str, Told, Told]] = []
        for parts in parts_of(self._session, meals) if meals else ():
            for state in fold_meal(parts).items:
                run_id = spellings(state.run_id)[self._spelling] if state.run_id is not None else None
                item_id = spellings(state.item.id)[self._spelling]
                folded.append((item_id, self._run(run_id), _weighing(state.food_assignment)))
        return folded

    def _run(self, run_id: str | None) -> Told:
        return self._runs([run_id])[0] if run_id is not None else NO_RUN


def _weighing(row: ItemFood | None) -> Told:
    return (row.layer, row.density_basis, row.density_sd_g_per_ml, row.edible_share) if row is not None else NOT_SAID
