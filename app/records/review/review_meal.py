"""Rules of events about a whole meal: confirm it, add, split and merge items, undo, leftovers, comments and questions.

Ids of items that an event creates follow from the event's id; such items exist as long as the event
counts.
"""

import math
import uuid
from collections.abc import Sequence

from app.core.errors import ConflictError, InvalidInputError, NotAllowedError, NotFoundError
from app.db.base import Base
from app.foods.models import Food
from app.meals.stored.event_models import MealEvent
from app.meals.stored.event_values import Answer
from app.meals.stored.item_state import (
    REMEASURING,
    UNKNOWN_AMOUNT,
    Amount,
    ItemState,
    live_events,
    read_event,
    required_items,
)
from app.meals.stored.record_models import Item, ItemFood, Leftover
from app.nutrition.doubt import Doubt, estimate
from app.records.item_foods import served_mass, weighing_of
from app.records.project_records import AFTER_MEASURED
from app.records.review.review_context import (
    Change,
    ReviewContext,
    StatedAmount,
    assign_food,
    copy_food,
    drawn_rings,
    food_key,
    named_food,
    new_item,
    remeasure_job,
    require_complete,
    stated_amount,
)
from app.records.review.schemas import (
    AddIn,
    AnswerIn,
    CommentIn,
    MergeIn,
    PartIn,
    QuestionIn,
    SetLeftoverIn,
    SplitIn,
    UndoIn,
)

SMALLEST = 0.001  # grams or millilitres, the least that any event may state
SPLIT_SD = 0.3  # of a share estimated by eye: a half is right to 15 %, nine tenths to 3 %


def confirm_meal(context: ReviewContext) -> Change:
    """Confirm the whole meal; a meal without foods is confirmed as one where nothing was eaten."""
    live = [state for state in context.state.items if state.is_live]
    require_complete(live)
    return Change(
        old={"status": context.meal.status},
        new={"status": "confirmed", "items": [str(state.item.id) for state in live]},
    )


def add(context: ReviewContext, event: AddIn, origin: str, default_sd: float) -> Change:
    """Add a food that was missed; with a region and no amount it is measured.

    default_sd: relative, of an amount that the event gives without one.
    """
    food = named_food(context.session, event.food) if event.food is not None else None
    amount = stated_amount(context.session, event.amount, food, default_sd)
    region = event.region if not amount else None
    item = new_item(
        context, origin, rings=drawn_rings(event.region) if event.region is not None else ()
    )
    rows: list[Base] = [item]
    if food is not None:
        rows.append(assign_food(context, item.id, food, event.lies_as))
    if region is not None:
        rows.append(remeasure_job(context))
    new = {
        "item": str(item.id),
        "food": food.key if food is not None else None,
        "lies_as": event.lies_as,
        "region": region.model_dump(mode="json") if region is not None else None,
        "share": event.share,
        **amount,
    }
    return Change(new=new, rows=rows)


def split(context: ReviewContext, event: SplitIn) -> Change:
    """Split an item by shares of its amount, by outlines to be measured, or by shares until outlines are measured."""
    state = context.item(event.item)
    _require_free(context, [state])
    items: list[Item] = []
    foods: list[ItemFood] = []
    new_parts = []
    for place, part in enumerate(_normalise_shares(event.parts)):
        item, mass = _split_part(context, state, place, part)
        if part.food is not None:
            foods.append(
                assign_food(context, item.id, named_food(context.session, part.food), part.lies_as)
            )
        elif state.food_assignment is not None:
            foods.append(
                copy_food(context, item.id, state.food_assignment, is_guessed=state.is_food_guessed)
            )
        items.append(item)
        new_parts.append({"item": str(item.id), **part.model_dump(mode="json"), **mass})
    jobs = [remeasure_job(context)] if any(part.polygon is not None for part in event.parts) else []
    return Change(
        old={"item": str(event.item), "food": food_key(context.session, state.food_assignment)},
        new={"parts": new_parts, "share": state.share},
        rows=[*items, *foods, *jobs],
    )


def merge(context: ReviewContext, event: MergeIn) -> Change:
    """Merge items into one with the sum of their amounts."""
    states = [context.item(item_id) for item_id in event.items]
    _require_free(context, states)
    if not all(state.is_live for state in states):
        raise ConflictError(
            "A rejected item cannot be merged: confirm it first, or leave it out.",
            code="item_rejected",
        )
    if len({state.share for state in states}) > 1:
        raise ConflictError(
            "The items are shared differently: set the same share of each before you merge them.",
            code="shares_differ",
        )
    volume = _summed_volume(states)
    item = new_item(
        context, "merged", rings=[ring for state in states for ring in state.rings], amount=volume
    )
    mass = _summed_mass(states) if volume.volume_ml is None else {}
    assignment = _merged_food(context, event, item, states)
    return Change(
        old={"foods": [food_key(context.session, state.food_assignment) for state in states]},
        new={
            "items": [str(item_id) for item_id in event.items],
            "item": str(item.id),
            "food": food_key(context.session, assignment),
            "share": states[0].share,
            **mass,
        },
        rows=[item, assignment] if assignment is not None else [item],
    )


def undo(context: ReviewContext, event: UndoIn) -> Change:
    """Undo an event of the author's layer; a reviewer may also undo a participant's."""
    target = next((earlier for earlier in context.parts.events if earlier.id == event.event), None)
    if target is None:
        raise NotFoundError("This meal has no such event.", code="event_not_found")
    if target.kind == "undo":
        raise ConflictError(
            "An undo cannot be undone: send the event again as a new one.", code="event_is_undo"
        )
    if all(live.event is not target for live in live_events(context.parts.events)):
        raise ConflictError("This event was undone before.", code="event_undone")
    if context.layer == "participant":
        if target.layer != "participant":
            raise NotAllowedError(
                "Only a reviewer can undo a reviewer's event.", code="event_not_yours"
            )
        _require_unreviewed(context, _created_from(context, target))
    return Change(old={"kind": target.kind, "new": target.new}, new={"event": str(event.event)})


def set_leftover(context: ReviewContext, event: SetLeftoverIn) -> Change:
    """Assign a piece of the after-meal pair to an item as food left or refuse, or to none.

    Raises NotFoundError if the meal has no such piece or item, ConflictError if the item was
    replaced or rejected.
    """
    piece = next(
        (piece for piece in context.state.leftovers if piece.state.item.id == event.item), None
    )
    if piece is None:
        raise NotFoundError("The after-meal pair has no such piece.", code="leftover_not_found")
    if event.of is not None and not context.item(event.of).is_live:
        raise ConflictError(
            "This item was rejected: nothing of it is left.",
            code="item_rejected",
            item=str(event.of),
        )
    earlier = context.parts.leftovers.get(event.item, ())
    row = Leftover(
        after_item_id=event.item,
        version=1 + max((row.version for row in earlier), default=0),
        item_id=event.of,
        leftover_class=event.leftover_class,
        layer=context.layer,
        event_id=context.event_id,
        flags=[],
        created_at=context.now,
    )
    old = {
        "of": str(piece.of_item_id) if piece.of_item_id is not None else None,
        "class": piece.leftover_class,
    }
    return Change(
        old=old, new=event.model_dump(mode="json", include={"of", "leftover_class"}), rows=[row]
    )


def nothing_left(context: ReviewContext) -> Change:
    """Record that all was eaten.

    Raises ConflictError if an after-meal pair was measured, which is more precise.
    """
    if context.meal.after_status in AFTER_MEASURED:
        raise ConflictError(
            "An after-meal pair was measured: classify its pieces instead (set_leftover).",
            code="after_pair_measured",
        )
    return Change(old={"nothing_left": context.state.nothing_left}, new={"nothing_left": True})


def write_text(context: ReviewContext, event: CommentIn | QuestionIn) -> Change:
    """Comment, or ask the participant, about an item or the meal; records do not change."""
    if event.item is not None:
        context.item(event.item)
    return Change(new={"text": event.text})


def answer(context: ReviewContext, event: AnswerIn) -> Change:
    """Answer a question. Raises NotFoundError, ConflictError."""
    live = live_events(context.parts.events)
    if not any(
        earlier.event.id == event.question and earlier.event.kind == "question" for earlier in live
    ):
        raise NotFoundError("This meal has no such open question.", code="question_not_found")
    if any(
        isinstance(earlier.value, Answer) and earlier.value.question == event.question
        for earlier in live
    ):
        raise ConflictError(
            "The question is answered: undo the answer to give another.", code="question_answered"
        )
    return Change(new={"question": str(event.question), "text": event.text})


def _normalise_shares(parts: Sequence[PartIn]) -> list[PartIn]:
    """Return the parts with shares that sum exactly to 1; the schema allows a small deviation."""
    shares = [part.share for part in parts if part.share is not None]
    if len(shares) < len(parts):
        return list(parts)
    total = math.fsum(shares)
    return [
        part.model_copy(update={"share": share / total})
        for part, share in zip(parts, shares, strict=True)
    ]


def _split_part(
    context: ReviewContext, whole: ItemState, place: int, part: PartIn
) -> tuple[Item, StatedAmount]:
    """Return a new item and, if the whole had stated grams, its share of them.

    Grams of a household measure hold for the measure's food only; a part of another food uses its
    share of the volume.
    """
    amount = whole.amount
    mass: StatedAmount = {}
    volume = UNKNOWN_AMOUNT
    if part.share is not None:
        share_sd = SPLIT_SD * (1.0 - part.share)
        whole_amount = amount.mass.mass_g if amount.mass is not None else amount.volume_ml
        if whole_amount is not None and whole_amount * part.share < SMALLEST:
            raise InvalidInputError(
                "A part of the item would be too small to be one.", code="part_too_small"
            )
        if amount.mass is not None:
            sd = math.hypot(amount.mass.relative_sd, share_sd)
            mass = {
                "mass_g": amount.mass.mass_g * part.share,
                "of": amount.mass.of,
                "relative_sd": sd,
            }
            if amount.mass.portion_of is not None:
                mass["portion_of"] = amount.mass.portion_of
        if amount.volume_ml is not None:
            pair_sd, item_sd = (
                amount.relative_sd.get("pair", 0.0),
                amount.relative_sd.get("item", 0.0),
            )
            volume = _volume(amount.volume_ml * part.share, pair_sd, math.hypot(item_sd, share_sd))
    rings = drawn_rings(part) if part.polygon is not None else whole.rings
    return new_item(
        context, "split", place=place, rings=rings, amount=volume, parent_id=whole.item.id
    ), mass


def _summed_volume(states: Sequence[ItemState]) -> Amount:
    """Return the sum of the volumes; unknown if one is unknown or an item has stated grams."""
    amounts = [state.amount for state in states]
    volumes_ml = [
        amount.volume_ml
        for amount in amounts
        if amount.volume_ml is not None and amount.mass is None
    ]
    if len(volumes_ml) < len(amounts):
        return UNKNOWN_AMOUNT
    total_ml = math.fsum(volumes_ml)
    pairs = list(zip(volumes_ml, amounts, strict=True))
    pair_sd = (
        math.fsum(volume_ml * amount.relative_sd.get("pair", 0.0) for volume_ml, amount in pairs)
        / total_ml
    )
    item_sd = (
        math.hypot(
            *(volume_ml * amount.relative_sd.get("item", 0.0) for volume_ml, amount in pairs)
        )
        / total_ml
    )
    return _volume(total_ml, pair_sd, item_sd)


def _summed_mass(states: Sequence[ItemState]) -> StatedAmount:
    """Return the sum of the grams as seen; empty if one is unknown."""
    masses = [
        mass
        for state in states
        if state.food_assignment is not None
        and (mass := served_mass(weighing_of(state.food_assignment), state.amount)) is not None
    ]
    if len(masses) < len(states):
        return {}
    total_g = math.fsum(mass.as_seen_g.value for mass in masses)
    sds = [mass.as_seen_g.value * math.sqrt(math.expm1(mass.doubt.log_variance)) for mass in masses]
    return {"mass_g": total_g, "of": "as_seen", "relative_sd": math.hypot(*sds) / total_g}


def _volume(volume_ml: float, pair_sd: float, item_sd: float) -> Amount:
    volume = estimate(volume_ml, Doubt(pair=pair_sd, item=item_sd))
    return Amount(volume.value, volume.low, volume.high, {"pair": pair_sd, "item": item_sd})


def _merged_food(
    context: ReviewContext, event: MergeIn, item: Item, states: Sequence[ItemState]
) -> ItemFood | None:
    """Assign the merged item to the stated food, else to the one food that its parts have; None if they have none."""
    if event.food is not None:
        return assign_food(context, item.id, named_food(context.session, event.food), event.lies_as)
    assignments = sorted(
        (
            (state.is_food_guessed, state.food_assignment)
            for state in states
            if state.food_assignment is not None
        ),
        key=lambda assignment: assignment[0],
    )
    if not assignments:
        return None
    if len({context.session.get_one(Food, row.food_id).key for _, row in assignments}) > 1:
        raise InvalidInputError(
            "The items are different foods: name in `food` which one they are together.",
            code="merge_needs_food",
        )
    is_guessed, row = assignments[0]
    return copy_food(context, item.id, row, is_guessed=is_guessed)


def _require_free(context: ReviewContext, states: Sequence[ItemState]) -> None:
    """Raise ConflictError if an item is being measured, or a participant would override a reviewer."""
    if any(REMEASURING in state.flags for state in states):
        raise ConflictError(
            "The item is being measured again: wait until it is done (GET the meal with ?wait=).",
            code="item_remeasuring",
        )
    if context.layer == "participant":
        _require_unreviewed(context, {state.item.id for state in states})


def _require_unreviewed(context: ReviewContext, item_ids: set[uuid.UUID]) -> None:
    reviewed = {
        item_id
        for live in live_events(context.parts.events)
        if live.event.layer == "reviewer" and live.event.kind not in ("comment", "question")
        for item_id in required_items(live)
    }
    reviewed |= {state.item.id for state in context.state.items if state.reviewed}
    if reviewed & item_ids:
        raise ConflictError("A reviewer has had the last word on this item.", code="item_reviewed")


def _created_from(context: ReviewContext, event: MealEvent) -> set[uuid.UUID]:
    """Return the items that an event created, and those created from them since."""
    created = {item.id for item in context.parts.items if item.event_id == event.id}
    sources = {
        earlier.id: set(required_items(read_event(earlier))) for earlier in context.parts.events
    }
    for item in sorted(context.parts.items, key=lambda item: item.position):
        if item.event_id in sources and sources[item.event_id] & created:
            created.add(item.id)
    return created
