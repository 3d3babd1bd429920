"""What an item may be, as far as the server tells: the phone's hint, and the index's word on its region as it stands.

A region that was drawn and measured anew was identified anew: its candidates hold, and those of the region before hold
again once the drawing is undone.
"""

from dataclasses import dataclass

from app.meals.item_state import ItemState
from app.meals.meal_parts import FROM_HINT, FROM_INDEX, Identified, MealParts
from app.meals.record_models import ItemCandidate


@dataclass(frozen=True, slots=True)
class ItemCandidates:
    """hints: who pointed; by_index: best first, each with its probability. identified: None, nobody has looked."""

    hints: tuple[ItemCandidate, ...]
    by_index: tuple[ItemCandidate, ...]
    identified: Identified | None

    @property
    def all(self) -> tuple[ItemCandidate, ...]:
        """The hint's at the head."""
        return self.hints + self.by_index

    @property
    def none_probability(self) -> float | None:
        """That it is none of those by index; None: nobody has looked."""
        return self.identified.none_probability if self.identified is not None else None


NOT_IDENTIFIED = ItemCandidates((), (), None)


def candidates_of(parts: MealParts, state: ItemState) -> ItemCandidates:
    """The candidates that hold for an item: of the run that saw its region, else of the run that found it."""
    item, rows = state.item, parts.candidates.get(state.item.id, ())
    by_run = {one.run_id: one for one in parts.identified.get(item.id, ()) if one.index_version is not None}
    run_id = state.run_id if state.run_id in by_run else item.run_id
    return ItemCandidates(
        hints=tuple(one for one in rows if one.source == FROM_HINT),
        by_index=tuple(one for one in rows if one.source == FROM_INDEX and (one.run_id or item.run_id) == run_id),
        identified=by_run.get(run_id) if run_id is not None else None,
    )
