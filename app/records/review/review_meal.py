"""What people say of a meal as a whole: it is right, items are one or several, a food is missing, a word is taken back.

Each function is the rule of one kind of event (event_rules.py). Items that an event makes get ids that follow
from the event's, and are there as long as it counts.
"""

import math
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotAllowedError, NotFoundError
from app.db.base import Base
from app.foods.models import Food
from app.meals.event_models import MealEvent
from app.meals.item_state import REMEASURING, ItemState, live_events, read_event, required_items
from app.meals.outline_json import rings_of
from app.meals.record_models import Item
from app.nutrition.doubt import Doubt, estimate
from app.nutrition.mass import Mass
from app.records.item_foods import served_mass, weighing_of
from app.records.review.meal_events import Change, Standing
from app.records.review.review_item import (
    food_assignment,
    key_of,
    named_food,
    remeasure_job,
    require_complete,
    same_food,
)
from app.records.review.told_amounts import TOLD_SD, told_amount

ITEMS_OF_EVENT = uuid.UUID("b1c4b7a3-8a0f-4f27-8d9d-2d9a4b2f60c5")  # drawn once; ids of items are derived under it
SMALLEST = 0.001  # grams or millilitres, as of all that is told
SPLIT_SD = 0.3  # of a share told by eye: a half is right to 15 %, nine tenths to 3 %


def confirm_meal(standing: Standing) -> Change:
    """All of it is right as it stands; a meal without foods is one where nothing was eaten."""
    live = [state for state in standing.state.items if state.is_live]
    require_complete(live)
    return Change(
        old={"status": standing.meal.status},
        new={"status": "confirmed", "items": [str(state.item.id) for state in live]},
    )


def add(standing: Standing) -> Change:
    """A food that was missed: where, what and how much, as far as it is known. A place without amount is measured."""
    return added(standing, "added", TOLD_SD)


def added(standing: Standing, origin: str, default_sd: float) -> Change:
    """A food that a person tells of. default_sd: how far off its amount may be, where the person does not say."""
    told, session = standing.event.told, standing.session
    food = named_food(session, told["food"]) if told["food"] is not None else None
    amount = told_amount(session, told["amount"], food, default_sd)
    region = told["region"] if not amount else None
    polygon = (told["region"] or {}).get("polygon")
    item = new_item(standing, origin, rings=rings_of(polygon) if polygon is not None else [])
    rows: list[Base] = [item]
    if food is not None:
        rows.append(food_assignment(standing, item.id, food, told["lies_as"]))
    if region is not None:
        rows.append(remeasure_job(standing))
    new = {
        "item": str(item.id), "food": food.key if food is not None else None, "lies_as": told["lies_as"],
        "region": region, "share": told["share"], **amount,
    }  # fmt: skip
    return Change(new=new, rows=rows)


def split(standing: Standing) -> Change:
    """One item is several: by shares of its amount, by outlines that are measured, or both until they are measured."""
    state = standing.item()
    _require_free(standing, [state])
    items: list[Item] = []
    food_rows: list[Base] = []
    parts = []
    for place, told in enumerate(_with_exact_shares(standing.event.told["parts"])):
        item, amount = _part(standing, state, place, told)
        if told["food"] is not None:
            food = named_food(standing.session, told["food"])
            food_rows.append(food_assignment(standing, item.id, food, told["lies_as"]))
        elif state.food_assignment is not None:
            food_rows.append(same_food(standing, item.id, state.food_assignment, is_guessed=state.is_food_guessed))
        items.append(item)
        parts.append({"item": str(item.id), **told, **amount})
    jobs = [remeasure_job(standing)] if any(part["polygon"] is not None for part in parts) else []
    return Change(
        old={"item": str(state.item.id), "food": key_of(standing.session, state.food_assignment)},
        new={"parts": parts, "share": state.share},
        rows=[*items, *food_rows, *jobs],
    )


def merge(standing: Standing) -> Change:
    """Several items are one; its amount is theirs together."""
    told, session = standing.event.told, standing.session
    states = [standing.item(uuid.UUID(item)) for item in told["items"]]
    _require_free(standing, states)
    if not all(state.is_live for state in states):
        raise ConflictError(
            "A rejected item cannot be merged: confirm it first, or leave it out.", code="item_rejected"
        )
    if len({state.share for state in states}) > 1:
        raise ConflictError(
            "The items are shared differently: set the same share of each before you merge them.", code="shares_differ"
        )
    item = new_item(
        standing, "merged", rings=[ring for state in states for ring in state.rings], **_summed_volume(states)
    )
    mass = {} if item.volume_ml is not None else _summed_mass(states)
    food = _merged_food(standing, item, states)
    new = {
        "items": list(told["items"]), "item": str(item.id), "food": key_of(session, food),
        "share": states[0].share, **mass,
    }  # fmt: skip
    old = {"foods": [key_of(session, state.food_assignment) for state in states]}
    return Change(old=old, new=new, rows=[item, food] if food is not None else [item])


def undo(standing: Standing) -> Change:
    """Take back an event of one's own layer; a reviewer also a participant's. What it made and replaced follows."""
    wanted = uuid.UUID(standing.event.told["event"])
    target = next((event for event in standing.parts.events if event.id == wanted), None)
    if target is None:
        raise NotFoundError("This meal has no such event.", code="event_not_found")
    if target.kind == "undo":
        raise ConflictError(
            "What was undone is said again, not restored: send it as a new event.", code="event_is_undo"
        )
    if all(word.event is not target for word in live_events(standing.parts.events)):
        raise ConflictError("This event was undone before.", code="event_undone")
    if standing.layer == "participant":
        if target.layer != "participant":
            raise NotAllowedError("Only a reviewer can undo what a reviewer said.", code="event_not_yours")
        _require_unreviewed(standing, _made_from(standing, target))
    return Change(old={"kind": target.kind, "new": target.new}, new={"event": str(wanted)})


def new_item(standing: Standing, origin: str, *, place: int = 0, rings: Sequence[Any] = (), **columns: Any) -> Item:
    """An item that this event makes. place: its number among them."""
    unknown: dict[str, Any] = {"volume_ml": None, "volume_low_ml": None, "volume_high_ml": None, "relative_sd": {}}
    return Item(
        id=uuid.uuid5(ITEMS_OF_EVENT, f"{standing.event.id}/{place}"),
        meal_id=standing.meal.id,
        origin=origin,
        event_id=standing.event.id,
        position=1 + max((item.position for item in standing.parts.items), default=-1) + place,
        rings=list(rings),
        flags=[],
        **unknown | columns,
    )


def _with_exact_shares(parts: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The parts with shares that sum to 1, which those that were told do as good as."""
    if any(part["share"] is None for part in parts):
        return list(parts)
    total = math.fsum(part["share"] for part in parts)
    return [{**part, "share": part["share"] / total} for part in parts]


def _part(standing: Standing, whole: ItemState, place: int, told: dict[str, Any]) -> tuple[Item, dict[str, Any]]:
    """One of the items that a split makes, and the grams that it has by share where those of the whole were told.

    Grams of a household measure stay those of the measure's food; the volume is there for a part that is another one.
    """
    share, amount = told["share"], whole.amount
    told_mass: dict[str, Any] = {}
    columns: dict[str, Any] = {}
    if share is not None:
        own_sd = SPLIT_SD * (1.0 - share)
        known = amount.mass.mass_g if amount.mass is not None else amount.volume_ml
        if known is not None and known * share < SMALLEST:
            raise InvalidInputError("A part of the item would be too small to be one.", code="part_too_small")
        if amount.mass is not None:
            sd = math.hypot(amount.mass.relative_sd, own_sd)
            told_mass = {"mass_g": amount.mass.mass_g * share, "of": amount.mass.of, "relative_sd": sd}
            if amount.mass.portion_of is not None:
                told_mass["portion_of"] = amount.mass.portion_of
        if amount.volume_ml is not None:
            pair_sd, item_sd = amount.relative_sd.get("pair", 0.0), amount.relative_sd.get("item", 0.0)
            columns = _volume(amount.volume_ml * share, pair_sd, math.hypot(item_sd, own_sd))
    rings = rings_of(told["polygon"]) if told["polygon"] is not None else whole.rings
    item = new_item(standing, "split", place=place, rings=rings, parent_id=whole.item.id, **columns)
    return item, told_mass


def _summed_volume(states: Sequence[ItemState]) -> dict[str, Any]:
    """The columns of a volume that is the sum of all; empty where one is not known or grams were told."""
    amounts = [state.amount for state in states]
    known = [amount.volume_ml for amount in amounts if amount.volume_ml is not None and amount.mass is None]
    if len(known) < len(amounts):
        return {}
    total_ml = math.fsum(known)
    pair = math.fsum(v * a.relative_sd.get("pair", 0.0) for v, a in zip(known, amounts, strict=True)) / total_ml
    item = math.hypot(*(v * a.relative_sd.get("item", 0.0) for v, a in zip(known, amounts, strict=True))) / total_ml
    return _volume(total_ml, pair, item)


def _summed_mass(states: Sequence[ItemState]) -> dict[str, Any]:
    """Grams that are the sum of all as seen; empty where one is not known."""
    masses = [
        served_mass(weighing_of(s.food_assignment), s.amount) if s.food_assignment is not None else None for s in states
    ]
    known: list[Mass] = [mass for mass in masses if mass is not None]
    if len(known) < len(masses):
        return {}
    total_g = math.fsum(mass.as_seen_g.value for mass in known)
    sds = [mass.as_seen_g.value * math.sqrt(math.expm1(mass.doubt.log_variance)) for mass in known]
    return {"mass_g": total_g, "of": "as_seen", "relative_sd": math.hypot(*sds) / total_g}


def _volume(volume_ml: float, pair: float, item: float) -> dict[str, Any]:
    found = estimate(volume_ml, Doubt(pair=pair, item=item))
    return {
        "volume_ml": found.value,
        "volume_low_ml": found.low,
        "volume_high_ml": found.high,
        "relative_sd": {"pair": pair, "item": item},
    }


def _merged_food(standing: Standing, item: Item, states: Sequence[ItemState]) -> Any:
    """What the merged item is taken for: as told, else what all are that are something; None if none is."""
    key = standing.event.told["food"]
    if key is not None:
        food = named_food(standing.session, key)
        return food_assignment(standing, item.id, food, standing.event.told["lies_as"])
    known = sorted(
        (state for state in states if state.food_assignment is not None), key=lambda each: each.is_food_guessed
    )
    rows = [state.food_assignment for state in known if state.food_assignment is not None]
    if not rows:
        return None
    if len({_same_as(standing.session, row.food_id) for row in rows}) > 1:
        raise InvalidInputError(
            "The items are different foods: say in `food` which one they are together.", code="merge_needs_food"
        )
    return same_food(standing, item.id, rows[0], is_guessed=known[0].is_food_guessed)


def _same_as(session: Session, food_id: int) -> str:
    return session.get_one(Food, food_id).key


def _require_free(standing: Standing, states: Sequence[ItemState]) -> None:
    """Raise ConflictError where an item is being measured, or a reviewer's word stands over the participant's."""
    if any(REMEASURING in state.flags for state in states):
        raise ConflictError(
            "The item is being measured anew: wait until it is (GET the meal with ?wait=).", code="item_remeasuring"
        )
    if standing.layer == "participant":
        _require_unreviewed(standing, {state.item.id for state in states})


def _require_unreviewed(standing: Standing, item_ids: set[uuid.UUID]) -> None:
    reviewed = {
        item_id
        for word in live_events(standing.parts.events)
        if word.event.layer == "reviewer" and word.event.kind not in ("comment", "question")
        for item_id in required_items(word)
    }
    reviewed |= {state.item.id for state in standing.state.items if state.reviewed}
    if reviewed & item_ids:
        raise ConflictError("A reviewer has had the last word on this item.", code="item_reviewed")


def _made_from(standing: Standing, event: MealEvent) -> set[uuid.UUID]:
    """The items that an event made, and those that were made from them since."""
    made = {item.id for item in standing.parts.items if item.event_id == event.id}
    by_event = {each.id: set(required_items(read_event(each))) for each in standing.parts.events}
    for item in sorted(standing.parts.items, key=lambda each: each.position):
        if item.event_id in by_event and by_event[item.event_id] & made:
            made.add(item.id)
    return made
