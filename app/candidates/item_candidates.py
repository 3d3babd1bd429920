"""The foods that an item may be: the phone's hint, the index's candidates for its current region, then a network's.

A region that was redrawn and measured again was also identified again, and only its candidates count; if the redrawing
is undone, those of the previous region count again.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food
from app.meals.stored import meal_parts
from app.meals.stored.meal_parts import FROM_HINT, FROM_INDEX, FROM_MODEL, Identified
from app.meals.stored.record_models import CandidateSource, EffectiveRecord, Item, ItemCandidate


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that an item may be. probability: by its source; None: a hint's."""

    food: Food
    probability: float | None
    source: CandidateSource


@dataclass(frozen=True, slots=True)
class ItemCandidates:
    """candidates: the hint's first, then the index's and a network's, each best first.

    identified: None if no run identified the item by the index.
    """

    candidates: tuple[Candidate, ...]
    identified: Identified | None

    @property
    def none_probability(self) -> float | None:
        """Probability that it is none of the index's candidates; None if no run identified the item."""
        return self.identified.none_probability if self.identified is not None else None


def current_candidates(
    rows: Sequence[ItemCandidate],
    identified: Sequence[Identified],
    *,
    seen_by: uuid.UUID | None,
    found_by: uuid.UUID | None,
) -> tuple[list[ItemCandidate], Identified | None]:
    """Return an item's current candidates: of the run that saw its current region, or else of the run that found it."""
    by_run = {each.run_id: each for each in identified if each.index_version is not None}
    is_seen_anew = seen_by in by_run or any(
        row.source == FROM_MODEL and row.run_id == seen_by for row in rows
    )
    run_id = seen_by if is_seen_anew else found_by
    of_run = [row for row in rows if row.source != FROM_HINT and (row.run_id or found_by) == run_id]
    ordered = [row for source in (FROM_INDEX, FROM_MODEL) for row in of_run if row.source == source]
    hints = [row for row in rows if row.source == FROM_HINT]
    return hints + ordered, by_run.get(run_id) if run_id is not None else None


def candidates_of_records(
    session: Session, rows_of_items: Sequence[tuple[EffectiveRecord, Item]]
) -> dict[uuid.UUID, ItemCandidates]:
    """Return item -> its candidates."""
    rows, identified = meal_parts.candidates_of_items(
        session, [item.id for _, item in rows_of_items]
    )
    current = {
        item.id: current_candidates(
            rows.get(item.id, ()),
            identified.get(item.id, ()),
            seen_by=record.run_id,
            found_by=item.run_id,
        )
        for record, item in rows_of_items
    }
    named = {row.food_id for chosen, _ in current.values() for row in chosen}
    by_id = {food.id: food for food in foods.foods_by_id(session, named)} if named else {}
    return {
        item_id: ItemCandidates(
            tuple(Candidate(by_id[row.food_id], row.probability, row.source) for row in chosen),
            identification,
        )
        for item_id, (chosen, identification) in current.items()
    }
