"""What the index said of a run's items, into the database: looks, candidates, and foods that items are taken for.

The answer says which; whether a food table knows a food is decided here. One that none in force knows is no candidate:
it cannot be chosen, so its probability goes to "none of these".
"""

import uuid
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food
from app.meals.identification_models import ItemIdentification
from app.meals.meal_parts import FROM_INDEX
from app.meals.record_models import Item, ItemCandidate
from app.meals.run_answer import ItemAnswer

TAKEN_FROM = 0.8  # of the first candidate: right or wrong, it is one tap, and a wrong guess must not slip into sums
MOST_CANDIDATES = 10
LEAST_PROBABILITY = 0.001

Seen = tuple[Item, ItemAnswer]  # an item, and what the run's answer says of it


def save_candidates(session: Session, run_id: uuid.UUID, seen: Sequence[Seen]) -> list[Food | None]:
    """Write what the items look like and what they may be. Returns the food that each is likely enough, or None."""
    session.flush()
    known = _foods_named(session, seen)
    places = _next_places(session, [item.id for item, _ in seen])
    now = datetime.now(UTC)
    likely: list[Food | None] = []
    for item, found in seen:
        candidates, none_probability = _candidates(found, known)
        vcm = found.vcm
        if vcm is not None:
            session.add(
                ItemIdentification(
                    item_id=item.id,
                    run_id=run_id,
                    vcm_version=vcm.version,
                    vector=vcm.vector,
                    index_version=found.index_version,
                    none_probability=none_probability,
                    created_at=now,
                )
            )
        session.add_all(
            ItemCandidate(
                item_id=item.id,
                position=position,
                food_id=food.id,
                probability=probability,
                source=FROM_INDEX,
                run_id=run_id,
            )
            for position, (food, probability) in enumerate(candidates, start=places.get(item.id, 0))
        )
        likely.append(candidates[0][0] if candidates and candidates[0][1] >= TAKEN_FROM else None)
    session.flush()
    return likely


def _foods_named(session: Session, seen: Sequence[Seen]) -> Mapping[str, Food]:
    """Key -> food in force, of all candidates of all items."""
    keys = {one.food for _, found in seen if found.index_version is not None for one in found.candidates}
    return foods.foods_by_key(session, keys) if keys else {}


def _next_places(session: Session, items: Collection[uuid.UUID]) -> dict[uuid.UUID, int]:
    """Item -> the position behind its candidates so far."""
    query = (
        sa.select(ItemCandidate.item_id, sa.func.max(ItemCandidate.position) + 1)
        .where(ItemCandidate.item_id.in_(items))
        .group_by(ItemCandidate.item_id)
    )
    return {row[0]: row[1] for row in session.execute(query)}


def _candidates(found: ItemAnswer, known: Mapping[str, Food]) -> tuple[list[tuple[Food, float]], float | None]:
    """The candidates that are kept, best first, and the probability of none of them; None: not identified."""
    if found.index_version is None or found.none_probability is None:
        return [], None
    named = [(known.get(one.food), one.probability) for one in found.candidates]
    unknown = sum(probability for food, probability in named if food is None)
    kept = [(food, p) for food, p in named if food is not None and p >= LEAST_PROBABILITY]
    return kept[:MOST_CANDIDATES], min(found.none_probability + unknown, 1.0)
