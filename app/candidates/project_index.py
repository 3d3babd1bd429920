"""Entries of the index: a projection like the records, of the items that people have confirmed.

There is one while the item's record is confirmed or corrected, a person has said or seen what it is, and the run that
saw its region as it stands has described it. What undoes any of that takes the entry away: nothing else is to be told.
"""

import uuid
from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session

from app.candidates import queries as index_entries
from app.candidates.models import IndexEntry
from app.meals.item_state import ItemState
from app.meals.meal_parts import MealParts
from app.meals.meal_time import local_minute

LEARNED = frozenset({"confirmed", "corrected"})  # record's statuses
NEVER_LEARNED = frozenset({"after", "declared"})  # pieces that were left, and what no camera saw

Columns = Mapping[str, Any]


def entry_of(parts: MealParts, state: ItemState, status: str, food_key: str | None) -> Columns | None:
    """The columns of the item's entry, None where it has none. status: its record's; food_key: what it is taken for."""
    item, meal = state.item, parts.meal
    seen = [one for one in parts.identified.get(item.id, ()) if one.run_id == state.run_id]
    is_learned = state.is_live and state.stands and status in LEARNED and state.food_is_told
    if not seen or not is_learned or food_key is None or item.origin in NEVER_LEARNED:
        return None
    newest = seen[-1]
    return {
        "item_id": item.id,
        "run_id": newest.run_id,
        "vcm_version": newest.vcm_version,
        "study_id": meal.study_id,
        "participant_id": meal.participant_id,
        "food_key": food_key,
        "volume_ml": state.amount.volume_ml,
        "captured_at": meal.captured_at,
        "day_minute": local_minute(meal.captured_at, meal.time_zone),
    }


def differing_entries(
    session: Session, meal_id: uuid.UUID, wanted: Mapping[uuid.UUID, Columns | None]
) -> dict[uuid.UUID, tuple[IndexEntry | None, Columns | None]]:
    """Item -> (its entry that is there, the columns that it should have), of the items of a meal where they differ."""
    here = index_entries.entries_of_meal(session, meal_id)
    pairs = {item_id: (here.get(item_id), wanted.get(item_id)) for item_id in {*here, *wanted}}
    return {item_id: pair for item_id, pair in pairs.items() if _differs(*pair)}


def write_entries(
    session: Session, meal_id: uuid.UUID, wanted: Mapping[uuid.UUID, Columns | None]
) -> frozenset[uuid.UUID]:
    """Make the entries of a meal as they should be. Returns the items whose entries were not."""
    differing = differing_entries(session, meal_id, wanted)
    for entry, columns in differing.values():
        if entry is None:
            session.add(IndexEntry(**columns or {}))
        elif columns is None:
            session.delete(entry)
        else:
            for name, value in columns.items():
                setattr(entry, name, value)
    return frozenset(differing)


def _differs(entry: IndexEntry | None, columns: Columns | None) -> bool:
    if entry is None or columns is None:
        return entry is not None or columns is not None
    return any(getattr(entry, name) != value for name, value in columns.items())
