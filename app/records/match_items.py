"""Match items of two pairs or two runs: leftovers with what was served, a remeasurement with the meal as it is.

What each piece of the after-meal pair is of which item, as far as the server can tell, is written
down when it changes. This happens whenever a meal is projected, so it does not matter which pair
was measured first, and what people say of the items meanwhile (another food, an item added) counts.
What people say of the pieces themselves is a layer above (records/review/review_meal.py) and taken
as given here. A piece that is not clearly of one item stays unmatched.

An item keeps its identity, and all that people said about it, if the run of a remeasurement
outlines the same food: items are matched one to one so that their outlines agree best, with an IoU
above one half. Items that nobody spoke of may go or be added. If a person's statement would lose
what it refers to, the old run is kept.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.event_values import Add, ConfirmMeal, Merge, Split
from app.meals.stored.item_state import (
    REPLACED,
    ItemState,
    LeftoverState,
    MealState,
    StatedEvent,
    fold_meal,
    live_events,
    pipeline_measure,
    required_items,
)
from app.meals.stored.job_models import PairPurpose
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.outline_json import rings_of
from app.meals.stored.record_models import Item, Leftover
from app.meals.stored.run_answer import ItemAnswer
from app.nutrition.mass import Mass
from app.nutrition.refuse_left import LeftoverClass, classify_left
from app.records.item_foods import served_mass, weighing_of
from app.vision.leftovers import Match, Sight, match_pieces
from app.vision.model import ItemTraits

AMBIGUOUS = "leftover_ambiguous"  # more than one item would do

Answer = tuple[uuid.UUID | None, str, list[str]]  # of which item, class, flags


def match_leftovers(session: Session, parts: MealParts, state: MealState) -> bool:
    """Write the server's own word on each piece where it is not what it was.

    Returns whether anything was written.
    """
    served = [each for each in state.items if each.is_live and each.item.origin != "declared"]
    pieces = [each for each in state.leftovers if each.state.is_live]
    if not pieces:
        return False
    now, is_new = datetime.now(UTC), False
    for piece, (item_id, leftover_class, flags) in zip(
        pieces, _answers(session, served, pieces), strict=True
    ):
        rows = parts.leftovers.get(piece.state.item.id, [])
        own = max(
            (row for row in rows if row.layer == "automatic"),
            key=lambda row: row.version,
            default=None,
        )
        if own is None:
            if item_id is None and not flags:
                continue  # unmatched is what holds without a word
        elif (own.item_id, own.leftover_class, list(own.flags)) == (item_id, leftover_class, flags):
            continue
        session.add(
            Leftover(
                after_item_id=piece.state.item.id,
                version=1 + max((row.version for row in rows), default=0),
                item_id=item_id,
                leftover_class=leftover_class,
                layer="automatic",
                flags=flags,
                created_at=now,
            )
        )
        is_new = True
    return is_new


def _answers(
    session: Session, served: Sequence[ItemState], pieces: Sequence[LeftoverState]
) -> list[Answer]:
    places = {each.item.id: place for place, each in enumerate(served)}
    stated: dict[int, int | None] = {}
    for j, piece in enumerate(pieces):
        if piece.is_by_person:
            stated[j] = places.get(piece.of_item_id) if piece.of_item_id is not None else None
        elif (hinted := _statement_of(piece.state.item).get("item")) is not None and uuid.UUID(
            hinted
        ) in places:
            stated[j] = places[uuid.UUID(hinted)]
    matches = match_pieces(
        [_sight(session, each) for each in served],
        [_sight(session, each.state) for each in pieces],
        stated,
    )
    classes = _classes(served, pieces, matches)
    return [
        (served[match.served].item.id, *classes[j])
        if match.served is not None
        else (None, "unmatched", [AMBIGUOUS] if match.is_ambiguous else [])
        for j, match in enumerate(matches)
    ]


def _statement_of(item: Item) -> Mapping[str, Any]:
    told: Mapping[str, Any] = item.traits.get("told", {})
    return told


def _classes(
    served: Sequence[ItemState], pieces: Sequence[LeftoverState], matches: Sequence[Match]
) -> dict[int, tuple[str, list[str]]]:
    """(class, flags) of the pieces that are matched."""
    out: dict[int, tuple[str, list[str]]] = {}
    for i, item in enumerate(served):
        of_it = [j for j, match in enumerate(matches) if match.served == i]
        masses = [_mass(item, pieces[j].state) for j in of_it]
        classes = classify_left(
            _mass(item, item), masses, [_stated_class(pieces[j]) for j in of_it]
        )
        out |= {
            j: (name, [flag] if flag is not None else [])
            for j, (name, flag) in zip(of_it, classes, strict=True)
        }
    return out


def _stated_class(piece: LeftoverState) -> LeftoverClass | None:
    stated_class = (
        piece.leftover_class if piece.is_by_person else _statement_of(piece.state.item).get("class")
    )
    if stated_class == "food_left":
        return "food_left"
    return "refuse" if stated_class == "refuse" else None


def _mass(item: ItemState, of: ItemState) -> Mass | None:
    """Grams of the item, or of a piece of it, by the item's food."""
    return (
        served_mass(weighing_of(item.food_assignment), of.amount)
        if item.food_assignment is not None
        else None
    )


def _sight(session: Session, state: ItemState) -> Sight:
    traits = state.item.traits
    centre, lab = traits.get("centre_mm"), traits.get("lab")
    relative_sd = state.amount.relative_sd
    return Sight(
        traits=ItemTraits(
            centre_mm=(centre[0], centre[1]) if centre is not None else None,
            radius_mm=traits.get("radius_mm"),
            lab=(lab[0], lab[1], lab[2]) if lab is not None else None,
        ),
        volume_ml=state.amount.volume_ml,
        relative_sd=sum(sd**2 for sd in relative_sd.values()) ** 0.5,
        food=session.get_one(Food, state.food_assignment.food_id).key
        if state.food_assignment is not None
        else None,
    )


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
    from app.vision.outline_overlap import matching_outlines  # noqa: PLC0415

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
