"""The foods that an item may be: the phone's hint, the index's candidates for its current region, then a network's.

A region that was redrawn and measured again was also identified again, and only its candidates
count; if the redrawing is undone, those of the previous region count again. Of a run's candidates,
those that no food table in force has are not saved: they cannot be chosen, so their probability is
added to "none of these".
"""

import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food
from app.meals.stored import meal_parts
from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.meal_parts import FROM_HINT, FROM_INDEX, FROM_MODEL, Identified
from app.meals.stored.record_models import CandidateSource, EffectiveRecord, Item, ItemCandidate
from app.meals.stored.run_answer import CandidateAnswer, ItemAnswer


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that an item may be. probability: by its source; None: a hint's. reasons: beside its looks."""

    food: Food
    probability: float | None
    source: CandidateSource
    reasons: Sequence[str] = ()


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
            tuple(
                Candidate(by_id[row.food_id], row.probability, row.source, row.reasons or ())
                for row in chosen
            ),
            identification,
        )
        for item_id, (chosen, identification) in current.items()
    }


MOST_CANDIDATES = 10
LEAST_PROBABILITY = 0.001

Seen = tuple[Item, ItemAnswer]  # an item and its part of the run's answer
Named = tuple[Food, CandidateAnswer]  # a candidate and its food in force


def save_candidates(session: Session, run_id: uuid.UUID, seen: Sequence[Seen]) -> list[Food | None]:
    """Save vectors and candidates.

    Returns the food of each item whose first candidate is likely and known well enough, or None.
    """
    session.flush()
    foods_by_key = _named_foods(session, seen)
    places = _next_places(session, [item.id for item, _ in seen])
    now = datetime.now(UTC)
    likely: list[Food | None] = []
    for item, answer in seen:
        candidates, none_probability = _candidates(answer, foods_by_key)
        vcm = answer.vcm
        if vcm is not None:
            session.add(
                ItemIdentification(
                    item_id=item.id,
                    run_id=run_id,
                    vcm_version=vcm.version,
                    vector=vcm.vector,
                    index_version=answer.index_version,
                    none_probability=none_probability,
                    created_at=now,
                )
            )
        by_model, _ = _known(answer.model_candidates, foods_by_key)
        from_all = [(FROM_INDEX, candidate) for candidate in candidates] + [
            (FROM_MODEL, candidate) for candidate in by_model
        ]
        session.add_all(
            ItemCandidate(
                item_id=item.id,
                position=position,
                food_id=food.id,
                probability=candidate.probability,
                source=source,
                run_id=run_id,
                reasons=candidate.reasons or None,
            )
            for position, (source, (food, candidate)) in enumerate(
                from_all, start=places.get(item.id, 0)
            )
        )
        likely.append(_assigned(candidates))
    session.flush()
    return likely


def _assigned(candidates: Sequence[Named]) -> Food | None:
    """Return the first candidate's food if nobody need be asked."""
    if not candidates:
        return None
    food, first = candidates[0]
    return food if first.is_sure else None


def _named_foods(session: Session, seen: Sequence[Seen]) -> Mapping[str, Food]:
    """Return key -> food in force, of all candidates of all items."""
    keys = {
        candidate.food
        for _, answer in seen
        if answer.index_version is not None
        for candidate in answer.candidates
    }
    keys |= {candidate.food for _, answer in seen for candidate in answer.model_candidates}
    return foods.foods_by_key(session, keys) if keys else {}


def _next_places(session: Session, items: Collection[uuid.UUID]) -> dict[uuid.UUID, int]:
    """Return item -> the next free position of its candidates."""
    query = (
        sa.select(ItemCandidate.item_id, sa.func.max(ItemCandidate.position) + 1)
        .where(ItemCandidate.item_id.in_(items))
        .group_by(ItemCandidate.item_id)
    )
    return {row[0]: row[1] for row in session.execute(query)}


def _candidates(
    answer: ItemAnswer, foods_by_key: Mapping[str, Food]
) -> tuple[list[Named], float | None]:
    """Return the saved candidates, best first, and the probability of none of them; None: not identified."""
    if answer.index_version is None or answer.none_probability is None:
        return [], None
    kept, unknown = _known(answer.candidates, foods_by_key)
    return kept, min(answer.none_probability + unknown, 1.0)


def _known(
    candidates: Sequence[CandidateAnswer], foods_by_key: Mapping[str, Food]
) -> tuple[list[Named], float]:
    """Return those of a food table in force, best first, and the probability of the others."""
    kept: list[Named] = []
    unknown = 0.0
    for candidate in candidates:
        food = foods_by_key.get(candidate.food)
        if food is None:
            unknown += 0.0 if candidate.is_group else candidate.probability
        elif candidate.probability >= LEAST_PROBABILITY:
            kept.append((food, candidate))
    return kept[:MOST_CANDIDATES], unknown
