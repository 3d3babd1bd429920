"""What holds for a meal's items: the pipeline's findings and people's events, folded into one state. Pure.

Three layers stay apart, automatic, participant, reviewer; for each property the highest layer that has said something
counts, in it the newest word. An undone event counts for nothing, whatever layer it is of.
"""

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.db.models import Item, ItemFood, Leftover, MealEvent
from app.db.models.review import LAYERS
from app.db.queries.meal_parts import MealParts
from app.nutrition.doubt import Doubt, estimate

CORRECTIONS = frozenset({"set_food", "set_volume", "set_mass", "redraw"})
WORDS = CORRECTIONS | {"confirm", "reject"}
REGIONS = frozenset({"redraw", "add", "split"})  # events that may carry a region to be measured
BY_HAND_SD = {"set_volume": 0.1, "set_mass": 0.1, "add": 0.2, "declare": 0.25}  # relative, where the author tells none
REMEASURING = "remeasuring"
REPLACED = "replaced"
UNDONE = "undone"


@dataclass(frozen=True, slots=True)
class SetMass:
    """Grams that a person set. of: "as_seen", with peel, core and bone, or "edible"."""

    mass_g: float
    of: str
    relative_sd: float


@dataclass(frozen=True, slots=True)
class Amount:
    """How much there is: a volume (ml, its 90 % interval, relative sd by part), or the grams that a person set.

    All None: not known. layer: who says so.
    """

    volume_ml: float | None
    volume_low_ml: float | None
    volume_high_ml: float | None
    relative_sd: Mapping[str, float]
    mass: SetMass | None = None
    layer: str = "automatic"


@dataclass(frozen=True, slots=True)
class ItemState:
    """An item as it stands. word: what a person has made of it, None, "confirmed", "corrected" or "rejected".

    reviewed: a reviewer has spoken of it. flags: of the measurement that counts, and REMEASURING, REPLACED, UNDONE.
    """

    item: Item
    rings: Sequence[Any]
    taken_for: ItemFood | None
    amount: Amount
    share: float
    word: str | None
    reviewed: bool
    flags: tuple[str, ...]

    @property
    def is_live(self) -> bool:
        """Whether it counts as food of the meal."""
        return self.word != "rejected"

    @property
    def stands(self) -> bool:
        """Whether it can be spoken of: nothing has taken its place, and what made it was not undone."""
        return REPLACED not in self.flags and UNDONE not in self.flags


@dataclass(frozen=True, slots=True)
class LeftoverState:
    """An item of the after-meal pair, and what it is of which item."""

    state: ItemState
    leftover_class: str
    of_item_id: uuid.UUID | None
    flags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MealState:
    """A meal's items in their order, what was left of them, and what people said of the meal as a whole."""

    items: tuple[ItemState, ...]
    leftovers: tuple[LeftoverState, ...]
    nothing_left: bool
    is_confirmed: bool


def fold_meal(parts: MealParts) -> MealState:
    """The state that follows from a meal's parts."""
    live = live_events(parts.events)
    history = _History(parts, live)
    states = [history.state(item) for item in parts.items]
    return MealState(
        items=tuple(state for state in states if state.item.origin != "after"),
        leftovers=tuple(history.leftover(state) for state in states if state.item.origin == "after"),
        nothing_left=any(event.kind == "nothing_left" for event in live),
        is_confirmed=any(event.kind == "confirm_meal" for event in live),
    )


def live_events(events: Sequence[MealEvent]) -> list[MealEvent]:
    """Those that count, in their order: an undo takes out the event that it names, unless it was undone itself."""
    undone: set[str] = set()
    kept = []
    for event in sorted(events, key=lambda each: each.sequence, reverse=True):
        if str(event.id) in undone:
            continue
        if event.kind == "undo":
            undone.add(event.new["event"])
        else:
            kept.append(event)
    return kept[::-1]


def region_drawn(event: MealEvent, item: Item) -> Mapping[str, Any] | None:
    """The region (point, box or polygon) that an event drew of an item, to be measured; None if it drew none of it."""
    region: Mapping[str, Any] | None = None
    if event.kind == "redraw" and event.item_id == item.id:
        region = {"polygon": event.new["polygon"]}
    elif event.kind == "add" and item.event_id == event.id:
        region = event.new["region"]
    elif event.kind == "split" and item.event_id == event.id:
        ring = next(part["polygon"] for part in event.new["parts"] if part["item"] == str(item.id))
        region = {"polygon": ring} if ring is not None else None
    return region


class _History:
    """What was said of the items of one meal."""

    def __init__(self, parts: MealParts, live: Sequence[MealEvent]) -> None:
        self._parts = parts
        self._live = live
        self._by_id = {event.id: event for event in live}
        self._replaced = set(_replaced(live))

    def state(self, item: Item) -> ItemState:
        """An item as it stands."""
        words = [event for event in self._live if event.item_id == item.id]
        amount, rings, flags = self._measured(item, words)
        word = self._word(item, words)
        if item.id in self._replaced:
            word, flags = "rejected", (*flags, REPLACED)
        if item.event_id is not None and item.event_id not in self._by_id:
            word, flags = "rejected", (*flags, UNDONE)
        shares = [event for event in words if event.kind == "set_share"]
        return ItemState(
            item=item,
            rings=rings,
            taken_for=self._newest_food(item),
            amount=amount,
            share=float(max(shares, key=_precedence).new["share"]) if shares else self._first_share(item),
            word=word,
            reviewed=any(event.layer == "reviewer" for event in self._spoken(item, words)),
            flags=flags,
        )

    def leftover(self, state: ItemState) -> LeftoverState:
        """What an item of the after-meal pair is."""
        rows = [row for row in self._parts.leftovers.get(state.item.id, ()) if self._counts(row.event_id)]
        if not rows:
            return LeftoverState(state, "unmatched", None, ())
        row: Leftover = max(rows, key=lambda each: (LAYERS.index(each.layer), each.version))
        return LeftoverState(state, row.leftover_class, row.item_id, tuple(row.flags))

    def _counts(self, event_id: uuid.UUID | None) -> bool:
        return event_id is None or event_id in self._by_id

    def _newest_food(self, item: Item) -> ItemFood | None:
        rows = [row for row in self._parts.foods.get(item.id, ()) if self._counts(row.event_id)]
        return max(rows, key=lambda row: (LAYERS.index(row.layer), row.version), default=None)

    def _measured(self, item: Item, words: Sequence[MealEvent]) -> tuple[Amount, Sequence[Any], tuple[str, ...]]:
        """(amount, rings, flags) by the precedence of those who said so; the pipeline's own comes before all."""
        found = _amount_of(item)
        amounts = [((-1, 0), found)]
        regions: list[tuple[tuple[int, int], Sequence[Any], Sequence[str]]] = [((-1, 0), item.rings, item.flags)]
        measured = {row.event_id: row for row in self._parts.measures.get(item.id, ())}
        made_by = self._by_id.get(item.event_id) if item.event_id is not None else None
        for event in ([made_by] if made_by is not None else []) + list(words):
            by_hand = _amount_by_hand(event, item)
            if by_hand is not None:
                amounts.append((_precedence(event), by_hand))
            if event.id in measured:
                row = measured[event.id]
                amounts.append((_precedence(event), _amount_of(row, event.layer)))
                regions.append((_precedence(event), row.rings, row.flags))
            elif event.kind == "redraw":
                regions.append((_precedence(event), event.new["polygon"], (REMEASURING,)))
        _, amount = max(amounts, key=lambda each: each[0])
        _, rings, flags = max(regions, key=lambda each: each[0])
        return amount, rings, tuple(flags)

    def _word(self, item: Item, words: Sequence[MealEvent]) -> str | None:
        spoken = self._spoken(item, words)
        if not spoken:
            return None
        last = max(spoken, key=_precedence)
        if last.kind == "reject":
            return "rejected"
        corrected = any(event.kind in CORRECTIONS | {"split", "merge"} for event in spoken)
        return "corrected" if corrected else "confirmed"

    def _spoken(self, item: Item, words: Sequence[MealEvent]) -> list[MealEvent]:
        """Events that say something of whether the item stands, the one that made it included."""
        of_all = [event for event in self._live if event.kind == "confirm_meal" and _is_named(event, item)]
        made_by = [self._by_id[item.event_id]] if item.event_id in self._by_id else []
        return [event for event in words if event.kind in WORDS] + of_all + made_by

    def _first_share(self, item: Item) -> float:
        made_by = self._by_id.get(item.event_id) if item.event_id is not None else None
        return float(made_by.new.get("share", 1.0)) if made_by is not None and made_by.kind == "declare" else 1.0


def _precedence(event: MealEvent) -> tuple[int, int]:
    return LAYERS.index(event.layer), event.sequence


def _is_named(event: MealEvent, item: Item) -> bool:
    """A meal is confirmed with the items that it then had."""
    return str(item.id) in event.new["items"]


def _replaced(live: Iterable[MealEvent]) -> Iterable[uuid.UUID]:
    for event in live:
        if event.kind == "split" and event.item_id is not None:
            yield event.item_id
        elif event.kind == "merge":
            yield from (uuid.UUID(item) for item in event.new["items"])


def _amount_of(row: Any, layer: str = "automatic") -> Amount:
    """Of an Item or an ItemMeasure, which have the same columns."""
    return Amount(row.volume_ml, row.volume_low_ml, row.volume_high_ml, row.relative_sd, layer=layer)


def _amount_by_hand(event: MealEvent, item: Item) -> Amount | None:
    """The amount that an event sets, if it does; for an event that made items, only for the item named."""
    told: Mapping[str, Any] = event.new
    if event.kind not in BY_HAND_SD or (event.item_id is not None and event.item_id != item.id):
        return None
    sd = told.get("relative_sd")
    relative_sd = BY_HAND_SD[event.kind] if sd is None else float(sd)
    if told.get("mass_g") is not None:
        mass = SetMass(float(told["mass_g"]), told.get("of", "as_seen"), relative_sd)
        measured = _amount_of(item)
        return Amount(
            measured.volume_ml, measured.volume_low_ml, measured.volume_high_ml, measured.relative_sd, mass, event.layer
        )
    if told.get("volume_ml") is not None:
        doubt = {"item": relative_sd}
        found = estimate(float(told["volume_ml"]), Doubt(item=relative_sd))
        return Amount(found.value, found.low, found.high, doubt, layer=event.layer)
    return None
