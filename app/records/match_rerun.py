"""Match the items of a remeasurement's run with those of the meal, and decide on which run the records rest. Pure.

An item keeps its identity, and all that people said about it, if the new run outlines the same food: items are matched
one to one so that their outlines agree best, with an IoU above one half. Items that nobody spoke of may go or be added.
If a person's statement would lose what it refers to, the old run is kept.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from app.meals.stored.event_values import Add, ConfirmMeal, Merge, Split
from app.meals.stored.item_state import (
    REPLACED,
    StatedEvent,
    fold_meal,
    live_events,
    pipeline_measure,
    required_items,
)
from app.meals.stored.job_models import PairPurpose
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.outline_json import rings_of
from app.meals.stored.record_models import Item
from app.meals.stored.run_answer import ItemAnswer

SAME_FOOD = 0.5  # IoU must exceed it
OTHER_ITEMS = "other_items"  # reasons to keep the old run
NOTHING_LEFT = "nothing_left"
ORIGINS = {"meal": "pipeline", "after": "after"}


@dataclass(frozen=True, slots=True)
class MatchedItems:
    """matched: (item, position in the answer); replaced: items that the new run lacks; added: positions of new ones.

    keep: the reason why the records must rest on the old run; None: they may rest on the new one.
    """

    matched: tuple[tuple[Item, int], ...] = ()
    replaced: tuple[Item, ...] = ()
    added: tuple[int, ...] = ()
    keep: str | None = None


def match_rerun(parts: MealParts, pair: PairPurpose, answers: Sequence[ItemAnswer]) -> MatchedItems:
    """Match the answer of a new run on a pair with the pair's items as they are."""
    old = [
        item
        for item in parts.items
        if item.origin == ORIGINS[pair] and REPLACED not in pipeline_measure(parts, item).flags
    ]
    matched = _same_foods(parts, old, answers)
    seen_again = {item.id for item, _ in matched}
    state, events = fold_meal(parts), live_events(parts.events)
    rejected = {
        each.item.id
        for each in (*state.items, *(left.state for left in state.leftovers))
        if each.stands and not each.is_live
    }
    gone = [item for item in old if item.id not in seen_again and item.id not in rejected]
    added = [place for place in range(len(answers)) if place not in {place for _, place in matched}]
    if any(item.id in _items_spoken_of(parts, events) for item in gone):
        return MatchedItems(keep=OTHER_ITEMS)
    if pair == "meal" and added and any(_states_which_items(stated) for stated in events):
        return MatchedItems(keep=OTHER_ITEMS)
    if pair == "after" and added and any(stated.event.kind == NOTHING_LEFT for stated in events):
        return MatchedItems(keep=NOTHING_LEFT)
    return MatchedItems(tuple(matched), tuple(gone), tuple(added))


def _same_foods(
    parts: MealParts, old: Sequence[Item], answers: Sequence[ItemAnswer]
) -> list[tuple[Item, int]]:
    """Return (item, position in the answer) of the same foods."""
    # NumPy and OpenCV come with it, which an API process has no other use for
    from app.vision.geometry.outline_overlap import matching_outlines  # noqa: PLC0415

    before = [pipeline_measure(parts, item).rings for item in old]
    pairs = matching_outlines(
        before, [rings_of(answer.polygon) for answer in answers], above=SAME_FOOD
    )
    return [(old[row], column) for row, column in pairs]


def _items_spoken_of(parts: MealParts, events: Sequence[StatedEvent]) -> set[uuid.UUID]:
    """Return the items that events, people's matches of leftovers, or a phone's hints of leftovers refer to."""
    spoken = {item_id for stated in events for item_id in required_items(stated)}
    spoken |= {
        item_id
        for stated in events
        if isinstance(stated.value, ConfirmMeal)
        for item_id in stated.value.items
    }
    by_people = (
        row for rows in parts.leftovers.values() for row in rows if row.layer != "automatic"
    )
    spoken |= {row.item_id for row in by_people if row.item_id is not None}
    hinted = (item.traits.get("told", {}).get("item") for item in parts.items)
    return spoken | {uuid.UUID(item_id) for item_id in hinted if item_id is not None}


def _states_which_items(stated: StatedEvent) -> bool:
    """Whether a person said which foods the meal has: another one of the pipeline's might be one of theirs."""
    return isinstance(stated.value, ConfirmMeal | Add | Split | Merge)
