"""What an item may be: the phone's hint, and the index's candidates for its region as it stands.

A region that was drawn and measured anew was identified anew: its candidates hold, and those of the region before hold
again once the drawing is undone.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food
from app.meals import meal_parts
from app.meals.meal_parts import FROM_HINT, FROM_INDEX, Identified
from app.meals.record_models import CandidateSource, EffectiveRecord, Item, ItemCandidate


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that an item may be. probability: by the index; None: a hint's."""

    food: Food
    probability: float | None
    source: CandidateSource


@dataclass(frozen=True, slots=True)
class ItemCandidates:
    """candidates: the hint's at the head, then the index's, best first. identified: None, no run has looked."""

    candidates: tuple[Candidate, ...]
    identified: Identified | None

    @property
    def none_probability(self) -> float | None:
        """Probability that it is none of those by the index; None: no run has looked."""
        return self.identified.none_probability if self.identified is not None else None


def current_candidates(
    rows: Sequence[ItemCandidate],
    identified: Sequence[Identified],
    *,
    seen_by: uuid.UUID | None,
    found_by: uuid.UUID | None,
) -> tuple[list[ItemCandidate], Identified | None]:
    """The rows that hold for an item: of the run that saw its region as it stands, else of the run that found it."""
    by_run = {each.run_id: each for each in identified if each.index_version is not None}
    run_id = seen_by if seen_by in by_run else found_by
    hints = [row for row in rows if row.source == FROM_HINT]
    by_index = [row for row in rows if row.source == FROM_INDEX and (row.run_id or found_by) == run_id]
    return hints + by_index, by_run.get(run_id) if run_id is not None else None


def candidates_of_records(
    session: Session, of: Sequence[tuple[EffectiveRecord, Item]]
) -> dict[uuid.UUID, ItemCandidates]:
    """Item -> its candidates."""
    rows, identified = meal_parts.candidates_of_items(session, [item.id for _, item in of])
    current = {
        item.id: current_candidates(
            rows.get(item.id, ()), identified.get(item.id, ()), seen_by=record.run_id, found_by=item.run_id
        )
        for record, item in of
    }
    named = {row.food_id for chosen, _ in current.values() for row in chosen}
    by_id = {food.id: food for food in foods.foods_by_id(session, named)} if named else {}
    return {
        item_id: ItemCandidates(
            tuple(Candidate(by_id[row.food_id], row.probability, row.source) for row in chosen), identification
        )
        for item_id, (chosen, identification) in current.items()
    }
