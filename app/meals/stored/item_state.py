"""Fold the pipeline's results and people's events into the current state of a meal's items. Pure.

There are three layers: automatic, participant, reviewer. For each property the highest layer with a
statement counts, and in it the newest statement. An undone event does not count, whatever its
layer, nor do events about items that an undone event made or that a split or merge has replaced.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from app.core.believable import says_nothing
from app.meals.stored.event_models import LAYERS, MealEvent
from app.meals.stored.event_values import (
    Add,
    AmountValue,
    ConfirmMeal,
    Declare,
    EventValue,
    Merge,
    Part,
    Redraw,
    Region,
    SetAmount,
    SetShare,
    Split,
    Undo,
    value_of,
)
from app.meals.stored.meal_parts import FROM_HINT, FROM_INDEX, MealParts
from app.meals.stored.outline_json import Ring, rings_of
from app.meals.stored.record_models import Item, ItemFood, ItemMeasure, Leftover, RecordStatus
from app.nutrition.doubt import Doubt, estimate

CORRECTED_ITEM = frozenset({"set_food", "set_volume", "set_mass", "reshape", "redraw"})
CORRECTIONS = CORRECTED_ITEM | {"split", "merge"}
ITEM_DECISIONS = CORRECTED_ITEM | {"confirm", "reject"}  # about one item
MAKES_ITEMS = (Add, Declare, Split, Merge)
REMEASURING = "remeasuring"
NOT_MEASURABLE = "not_measurable"
REMEASURE_FAILED = "remeasure_failed"
REPLACED = "replaced"
UNDONE = "undone"
OF_REJECTED = "of_rejected"
# dishes and foods around are of unusual sizes by the marker's declared size
SCALE_DOUBTFUL = "scale_doubtful"
COPIED = "copied"  # an entry with food and amount of a former meal or a favourite
# nobody eats so much of a food, or the photographs show far more or less
IMPLAUSIBLE_AMOUNT = "implausible_amount"
FOOD_IDENTIFIED = "food_identified"  # only the server has identified it
FOOD_DOUBTFUL = "food_doubtful"  # the index is sure of another food than the hint's


@dataclass(frozen=True, slots=True)
class SetMass:
    """Grams that a person set. of: "as_seen", with peel, core and bone, or "edible".

    portion_of: key of the food whose household measure was entered: the grams count while the item
    has this food. None: the grams count whatever the food.
    """

    mass_g: float
    of: Literal["as_seen", "edible"]
    relative_sd: float
    portion_of: str | None = None


@dataclass(frozen=True, slots=True)
class Amount:
    """A volume (ml, its 90 % interval, relative sd by part), or the grams that a person set; all None: unknown.

    layer: that of the statement which set it.
    """

    volume_ml: float | None
    volume_low_ml: float | None
    volume_high_ml: float | None
    relative_sd: Mapping[str, float]
    mass: SetMass | None = None
    layer: str = "automatic"


UNKNOWN_AMOUNT = Amount(None, None, None, {})


@dataclass(frozen=True, slots=True)
class ItemState:
    """The current state of an item.

    decision: a person's: None, "confirmed", "corrected" or "rejected"
    reviewed: a reviewer's statement counts
    is_food_confirmed: a person named or confirmed the food; is_food_guessed: only the index
        identified it
    flags: of the measurement that counts, and those named above
    run_id: the run that saw its current region; None: no run did
    measured_ml: by the pipeline, whatever a person has stated; None: not measured
    """

    item: Item
    rings: Sequence[Ring]
    food_assignment: ItemFood | None
    amount: Amount
    share: float
    decision: RecordStatus | None
    reviewed: bool
    is_food_confirmed: bool
    flags: tuple[str, ...]
    is_food_guessed: bool = False
    run_id: uuid.UUID | None = None
    measured_ml: float | None = None

    @property
    def is_live(self) -> bool:
        """Whether it is a food of the meal."""
        return self.decision != "rejected"

    @property
    def stands(self) -> bool:
        """Whether events may refer to it: it was not replaced, and the event that made it was not undone."""
        return REPLACED not in self.flags and UNDONE not in self.flags


@dataclass(frozen=True, slots=True)
class StatedEvent:
    """An event with its parsed value."""

    event: MealEvent
    value: EventValue

    @property
    def precedence(self) -> tuple[int, int]:
        """Sort key, by layer, then by time: the greater one counts."""
        return LAYERS.index(self.event.layer), self.event.sequence


@dataclass(frozen=True, slots=True)
class LeftoverState:
    """An item of the after-meal pair and the item that it was left of.

    is_by_person: a person matched them.
    """

    state: ItemState
    leftover_class: str
    of_item_id: uuid.UUID | None
    flags: tuple[str, ...]
    is_by_person: bool = False


@dataclass(frozen=True, slots=True)
class MealState:
    """A meal's items and leftovers in their order, and events about the whole meal.

    answers: item -> the probes that were answered for it, or for the items that it was made from.
    """

    items: tuple[ItemState, ...]
    leftovers: tuple[LeftoverState, ...]
    answers: Mapping[uuid.UUID, frozenset[str]]
    nothing_left: bool
    is_confirmed: bool


def fold_meal(parts: MealParts) -> MealState:
    """Return the state that follows from a meal's parts."""
    history = _History(parts)
    states = history.states()
    return MealState(
        items=tuple(state for state in states if state.item.origin != "after"),
        leftovers=tuple(
            history.leftover(state) for state in states if state.item.origin == "after"
        ),
        answers=history.answers(),
        nothing_left=any(stated.event.kind == "nothing_left" for stated in history.effective),
        is_confirmed=any(isinstance(stated.value, ConfirmMeal) for stated in history.effective),
    )


def live_events(events: Sequence[MealEvent]) -> list[StatedEvent]:
    """Return the events that were not undone, in their order."""
    undone: set[uuid.UUID] = set()
    live = []
    for event in sorted(events, key=lambda each: each.sequence, reverse=True):
        if event.id in undone:
            continue
        stated = read_event(event)
        if isinstance(stated.value, Undo):
            undone.add(stated.value.event)
        else:
            live.append(stated)
    return live[::-1]


def pipeline_measure(parts: MealParts, item: Item) -> Item | ItemMeasure:
    """Return the item's newest measurement by the pipeline: that of a remeasurement, else the item's own."""
    place = {run_id: number for number, run_id in enumerate(parts.runs)}
    rows = [
        row
        for row in parts.measures.get(item.id, ())
        if row.event_id is None and row.run_id in place
    ]
    return max(rows, key=lambda row: place[row.run_id]) if rows else item


def read_event(event: MealEvent) -> StatedEvent:
    """Parse the event's value."""
    return StatedEvent(event, value_of(event))


def drawn_region(stated: StatedEvent, item: Item) -> Region | None:
    """Return the region that an event drew for an item, to be measured; None if it drew none."""
    value, is_made = stated.value, item.event_id == stated.event.id
    if isinstance(value, Redraw) and stated.event.item_id == item.id:
        return Region(polygon=value.polygon)
    if isinstance(value, Add) and is_made:
        return value.region
    if isinstance(value, Split) and is_made:
        polygon = _part_of(value, item).polygon
        return Region(polygon=polygon) if polygon is not None else None
    return None


def stated_form(stated: StatedEvent, item: Item) -> str | None:
    """Return the form on the plate that the event stated for an item that it made."""
    if isinstance(stated.value, Split):
        return _part_of(stated.value, item).lies_as
    return stated.value.lies_as if isinstance(stated.value, Add) else None


def required_items(stated: StatedEvent) -> list[uuid.UUID]:
    """Return the items that must stand for the event to count: the one that it is about, those that it merges."""
    about = [stated.event.item_id] if stated.event.item_id is not None else []
    return about + (stated.value.items if isinstance(stated.value, Merge) else [])


class _History:
    """The history of one meal. effective: the events that count, in their order."""

    def __init__(self, parts: MealParts) -> None:
        self._parts = parts
        self._items = {item.id: item for item in parts.items}
        self._replaced_by: dict[uuid.UUID, StatedEvent] = {}
        self._by_id: dict[uuid.UUID, StatedEvent] = {}
        self._of_item: dict[uuid.UUID, list[StatedEvent]] = {}
        for stated in live_events(parts.events):
            if all(self._stands(item_id) for item_id in required_items(stated)):
                self._count(stated)
        self.effective = list(self._by_id.values())

    def states(self) -> list[ItemState]:
        """Return the items' states in their order.

        Items that were declared with a rejected one are rejected too.
        """
        states = {item.id: self._state(item) for item in self._parts.items}
        for item_id, state in states.items():
            parent = states.get(state.item.parent_id) if state.item.parent_id is not None else None
            is_of_rejected = (
                state.item.origin == "declared"
                and parent is not None
                and parent.stands
                and not parent.is_live
            )
            if is_of_rejected and state.stands:
                states[item_id] = replace(
                    state, decision="rejected", flags=(*state.flags, OF_REJECTED)
                )
        return list(states.values())

    def leftover(self, state: ItemState) -> LeftoverState:
        """Match an item of the after-meal pair: to the merge of a merged item; a split item's is unmatched."""
        rows = [
            row
            for row in self._parts.leftovers.get(state.item.id, ())
            if self._counts(row.event_id)
        ]
        if not rows:
            return LeftoverState(state, "unmatched", None, ())
        row: Leftover = max(rows, key=lambda each: (LAYERS.index(each.layer), each.version))
        of_item_id = self._successor(row.item_id) if row.item_id is not None else None
        leftover_class = row.leftover_class if of_item_id is not None else "unmatched"
        is_by_person = row.layer != "automatic" and (row.item_id is None or of_item_id is not None)
        return LeftoverState(state, leftover_class, of_item_id, tuple(row.flags), is_by_person)

    def answers(self) -> dict[uuid.UUID, frozenset[str]]:
        """Return item -> the probes that were answered for it, or for the items that it was made from."""
        answers: dict[uuid.UUID, frozenset[str]] = {}
        for item in sorted(self._parts.items, key=lambda each: each.position):
            values = [stated.value for stated in self._of_item.get(item.id, ())]
            made_by = self._made_by(item)
            made_from = (
                required_items(made_by)
                if made_by is not None and isinstance(made_by.value, Split | Merge)
                else []
            )
            own = frozenset(value.probe for value in values if isinstance(value, Declare))
            answers[item.id] = own.union(*(answers.get(each, frozenset()) for each in made_from))
        return answers

    def _count(self, stated: StatedEvent) -> None:
        event = stated.event
        self._by_id[event.id] = stated
        if event.item_id is not None:
            self._of_item.setdefault(event.item_id, []).append(stated)
        if isinstance(stated.value, Split | Merge):
            self._replaced_by |= dict.fromkeys(required_items(stated), stated)

    def _made_by(self, item: Item) -> StatedEvent | None:
        """Return the event that made the item, if there is one and it counts."""
        return self._by_id.get(item.event_id) if item.event_id is not None else None

    def _counts(self, event_id: uuid.UUID | None) -> bool:
        return event_id is None or event_id in self._by_id

    def _stands(self, item_id: uuid.UUID) -> bool:
        """Whether the item exists after the events so far."""
        item = self._items.get(item_id)
        if item is None or REPLACED in pipeline_measure(self._parts, item).flags:
            return False
        return self._counts(item.event_id) and item_id not in self._replaced_by

    def _successor(self, item_id: uuid.UUID) -> uuid.UUID | None:
        while item_id in self._replaced_by:
            stated = self._replaced_by[item_id]
            if not isinstance(stated.value, Merge):
                return None
            item_id = next(
                item.id for item in self._parts.items if item.event_id == stated.event.id
            )
        return item_id if self._stands(item_id) else None

    def _state(self, item: Item) -> ItemState:
        statements = self._of_item.get(item.id, [])
        made_by = self._made_by(item)
        deciding = [stated for stated in statements if stated.event.kind in ITEM_DECISIONS]
        if made_by is not None:
            deciding.append(made_by)
        deciding += [
            each
            for each in self.effective
            if isinstance(each.value, ConfirmMeal) and item.id in each.value.items
        ]
        food_assignment = self._newest_food(item)
        food_key = (
            self._parts.food_keys[food_assignment.food_id] if food_assignment is not None else None
        )
        is_confirmed = any(each.event.kind in ("confirm", "confirm_meal") for each in deciding)
        measured = _measured(
            self._parts, item, made_by, statements, food_key, is_confirmed=is_confirmed
        )
        decision, flags = _decision(deciding), measured.flags
        if item.id in self._replaced_by or REPLACED in pipeline_measure(self._parts, item).flags:
            decision, flags = "rejected", (*(flag for flag in flags if flag != REPLACED), REPLACED)
        if not self._counts(item.event_id):
            decision, flags = "rejected", (*flags, UNDONE)
        return ItemState(
            item=item,
            rings=measured.rings,
            food_assignment=food_assignment,
            amount=measured.amount,
            share=self._share(item),
            decision=decision,
            reviewed=any(each.event.layer == "reviewer" for each in deciding),
            is_food_confirmed=is_confirmed
            or (food_assignment is not None and food_assignment.layer != "automatic"),
            flags=flags,
            is_food_guessed=not is_confirmed and self._is_guessed(item, food_assignment),
            run_id=measured.run_id,
            measured_ml=measured.measured_ml,
        )

    def _is_guessed(self, item: Item, food_assignment: ItemFood | None) -> bool:
        """Whether the index identified it, without a hint; a part of a guessed item is guessed too."""
        if food_assignment is None or food_assignment.layer != "automatic":
            return False
        sources = {candidate.source for candidate in self._parts.candidates.get(item.id, ())}
        return FROM_HINT not in sources and (
            FROM_INDEX in sources or food_assignment.event_id is not None
        )

    def _share(self, item: Item) -> float:
        """Return the participant's share of an item; a declared item without one has the share of its parent."""
        made_by = self._made_by(item)
        shares = [
            (stated.precedence, stated.value.share)
            for stated in self._of_item.get(item.id, ())
            if isinstance(stated.value, SetShare)
        ]
        first = (
            made_by.value.share
            if made_by is not None and isinstance(made_by.value, MAKES_ITEMS)
            else None
        )
        if made_by is not None and isinstance(made_by.value, Add | Declare) and first is not None:
            # a split or a merge only passes the share on
            shares.append((made_by.precedence, first))
        if shares:
            return max(shares)[1]
        if (
            made_by is not None
            and isinstance(made_by.value, Declare)
            and item.parent_id in self._items
        ):
            return self._share(self._items[item.parent_id])
        return first if first is not None else 1.0

    def _newest_food(self, item: Item) -> ItemFood | None:
        rows = [row for row in self._parts.foods.get(item.id, ()) if self._counts(row.event_id)]
        return max(rows, key=lambda row: (LAYERS.index(row.layer), row.version), default=None)


@dataclass(frozen=True, slots=True)
class _Measured:
    amount: Amount
    rings: Sequence[Ring]
    flags: tuple[str, ...]
    run_id: uuid.UUID | None
    measured_ml: float | None


# precedence of what the pipeline measured by itself: below every statement
PIPELINE_MEASUREMENT = (-1, 0)


def _measured(
    parts: MealParts,
    item: Item,
    made_by: StatedEvent | None,
    statements: Sequence[StatedEvent],
    food_key: str | None,
    *,
    is_confirmed: bool,
) -> _Measured:
    """Return an item's amount and region. food_key: of its assigned food.

    The newest drawn region counts. Until it is measured, the amount stays as it was; if it cannot
    be measured, the amount of the old region is dropped and only a stated amount remains. A volume
    of the pipeline's whose interval says nothing counts only if somebody has confirmed it.
    """
    about = sorted(
        [*([made_by] if made_by is not None else []), *statements],
        key=lambda stated: stated.precedence,
        reverse=True,
    )
    drawn = [stated for stated in about if drawn_region(stated, item) is not None]
    rows = {
        row.event_id: row for row in parts.measures.get(item.id, ()) if row.event_id is not None
    }
    own = pipeline_measure(parts, item)
    settled = rows.keys() | parts.failed_remeasures
    done = next((stated for stated in drawn if stated.event.id in settled), None)
    measured_at, measured = PIPELINE_MEASUREMENT, _measured_amount(own)
    rings: Sequence[Ring] = own.rings
    flags, run_id = list(own.flags), own.run_id
    if _says_nothing(own) and not is_confirmed:
        measured, flags = UNKNOWN_AMOUNT, [*flags, NOT_MEASURABLE]
    if done is not None:
        row = rows.get(done.event.id)
        measured_at = done.precedence
        measured = _measured_amount(row, done.event.layer) if row is not None else UNKNOWN_AMOUNT
        rings, flags = (
            (row.rings, list(row.flags))
            if row is not None
            else (_rings(done, item), [REMEASURE_FAILED])
        )
        run_id = row.run_id if row is not None else None
    if drawn and drawn[0] is not done:
        rings, flags = _rings(drawn[0], item), [REMEASURING]
    for stated in about:
        amount = _stated_amount(stated, item, food_key)
        if amount is None:
            continue
        if measured.volume_ml is None or stated.precedence > measured_at:
            is_newest = not drawn or stated.precedence >= drawn[0].precedence
            kept = [flag for flag in flags if flag in (REMEASURING, COPIED)] if is_newest else flags
            return _Measured(
                _amount_from(amount, stated, measured),
                rings,
                tuple(kept),
                run_id,
                measured.volume_ml,
            )
        break  # only the newest stated amount can count
    return _Measured(measured, rings, tuple(flags), run_id, measured.volume_ml)


def _rings(stated: StatedEvent, item: Item) -> Sequence[Ring]:
    """Return the region that an event drew; an item that the event made has it as its own."""
    return rings_of(stated.value.polygon) if isinstance(stated.value, Redraw) else item.rings


def _decision(deciding: Sequence[StatedEvent]) -> RecordStatus | None:
    """Return people's decision on an item: the last one of the highest layer decides whether it exists."""
    if not deciding:
        return None
    if max(deciding, key=lambda stated: stated.precedence).event.kind == "reject":
        return "rejected"
    return (
        "corrected" if any(stated.event.kind in CORRECTIONS for stated in deciding) else "confirmed"
    )


def _part_of(value: Split, item: Item) -> Part:
    """Return the split's statement on one of the items that it made."""
    return next(part for part in value.parts if part.item == item.id)


def _stated_amount(stated: StatedEvent, item: Item, food_key: str | None) -> AmountValue | None:
    """Return the amount that the event states for the item.

    A household measure counts for its own food only.
    """
    value: EventValue | Part = stated.value
    is_made = item.event_id == stated.event.id
    if isinstance(value, Split) and is_made:
        value = _part_of(value, item)
    if not isinstance(value, SetAmount) and not (is_made and isinstance(value, AmountValue)):
        return None
    is_of_food = value.portion_of in (None, food_key)
    return (
        value if (value.mass_g is not None and is_of_food) or value.volume_ml is not None else None
    )


def _amount_from(amount: AmountValue, stated: StatedEvent, measured: Amount) -> Amount:
    """Return the amount that an event sets. measured: its volume is shown beside stated grams."""
    layer, relative_sd = stated.event.layer, amount.relative_sd
    if amount.mass_g is not None:
        return replace(
            measured,
            mass=SetMass(amount.mass_g, amount.of, relative_sd, amount.portion_of),
            layer=layer,
        )
    if amount.volume_ml is None:
        raise ValueError(f"event {stated.event.id} states no amount")
    volume = estimate(amount.volume_ml, Doubt(item=relative_sd))
    return Amount(volume.value, volume.low, volume.high, {"item": relative_sd}, layer=layer)


def _measured_amount(row: Item | ItemMeasure, layer: str = "automatic") -> Amount:
    return Amount(
        row.volume_ml, row.volume_low_ml, row.volume_high_ml, row.relative_sd, layer=layer
    )


def _says_nothing(row: Item | ItemMeasure) -> bool:
    """Return whether an interval is too wide to be believed; runs of earlier versions have such ones."""
    if row.volume_ml is None or row.volume_low_ml is None or row.volume_high_ml is None:
        return False
    return says_nothing(row.volume_ml, row.volume_low_ml, row.volume_high_ml)
