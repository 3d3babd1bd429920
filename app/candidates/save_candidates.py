"""Save the identification of a run's items: feature vectors and candidates.

A candidate that no food table in force has is dropped: it cannot be chosen, so its probability is added to "none of
these".
"""

import uuid
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food
from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.meal_parts import FROM_INDEX, FROM_MODEL
from app.meals.stored.record_models import Item, ItemCandidate
from app.meals.stored.run_answer import CandidateAnswer, ItemAnswer

# probability of the first candidate; a wrong food must not enter sums unnoticed
ASSIGNED_FROM = 0.8
MOST_CANDIDATES = 10
LEAST_PROBABILITY = 0.001

Seen = tuple[Item, ItemAnswer]  # an item and its part of the run's answer


def save_candidates(session: Session, run_id: uuid.UUID, seen: Sequence[Seen]) -> list[Food | None]:
    """Save vectors and candidates. Returns the food of each item whose first candidate is likely enough, or None."""
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
        from_all = [(FROM_INDEX, each) for each in candidates] + [
            (FROM_MODEL, each) for each in by_model
        ]
        session.add_all(
            ItemCandidate(
                item_id=item.id,
                position=position,
                food_id=food.id,
                probability=probability,
                source=source,
                run_id=run_id,
            )
            for position, (source, (food, probability)) in enumerate(
                from_all, start=places.get(item.id, 0)
            )
        )
        likely.append(
            candidates[0][0] if candidates and candidates[0][1] >= ASSIGNED_FROM else None
        )
    session.flush()
    return likely


def _named_foods(session: Session, seen: Sequence[Seen]) -> Mapping[str, Food]:
    """Return key -> food in force, of all candidates of all items."""
    keys = {
        each.food
        for _, answer in seen
        if answer.index_version is not None
        for each in answer.candidates
    }
    keys |= {each.food for _, answer in seen for each in answer.model_candidates}
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
) -> tuple[list[tuple[Food, float]], float | None]:
    """Return the saved candidates, best first, and the probability of none of them; None: not identified."""
    if answer.index_version is None or answer.none_probability is None:
        return [], None
    kept, unknown = _known(answer.candidates, foods_by_key)
    return kept, min(answer.none_probability + unknown, 1.0)


def _known(
    candidates: Sequence[CandidateAnswer], foods_by_key: Mapping[str, Food]
) -> tuple[list[tuple[Food, float]], float]:
    """Return those of a food table in force, best first, and the probability of the others."""
    named = [(foods_by_key.get(each.food), each.probability) for each in candidates]
    unknown = sum(probability for food, probability in named if food is None)
    kept = [(food, p) for food, p in named if food is not None and p >= LEAST_PROBABILITY]
    return kept[:MOST_CANDIDATES], unknown
