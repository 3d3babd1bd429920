"""What holds for a meal's items: the pipeline's findings and people's events, folded into one state. Pure.

Three layers stay apart, automatic, participant, reviewer; for each property the highest layer that has said something
counts, in it the newest word. An undone event counts for nothing, whatever layer it is of, and so does what was said of
items that it made, or of items that something else has taken the place of.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from app.meals.event_models import LAYERS, MealEvent
from app.meals.event_values import (
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
from app.meals.meal_parts import FROM_HINT, FROM_INDEX, MealParts
from app.meals.outline_json import Ring, rings_of
from app.meals.record_models import Item, ItemFood, ItemMeasure, Leftover, RecordStatus
from app.nutrition.doubt import Doubt, estimate

CORRECTIONS = frozenset({"set_food", "set_volume", "set_mass", "redraw", "split", "merge"})
WORDS = frozenset({"confirm", "reject", "set_food", "set_volume", "set_mass", "redraw"})  # of one item that was there
MAKES_ITEMS = (Add, Declare, Split, Merge)
REMEASURING = "remeasuring"
REMEASURE_FAILED = "remeasure_failed"
REPLACED = "replaced"
UNDONE = "undone"
OF_REJECTED = "of_rejected"
FOOD_IDENTIFIED = "food_identified"  # the server alone says what it is
FOOD_DOUBTFUL = "food_doubtful"  # a hint says what it is, and the index is sure that it is another food


@dataclass(frozen=True, slots=True)
class SetMass:
    """Grams that a person set. of: "as_seen", with peel, core and bone, or "edible".

    portion_of: key of the food whose household measure was told: the grams count while the item is this food. None:
    grams that were told as such, of whatever food it is.
    """

    mass_g: float
    of: str
    relative_sd: float
    portion_of: str | None = None


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


NOTHING_KNOWN = Amount(None, None, None, {})


@dataclass(frozen=True, slots=True)
class ItemState:
    """An item as it stands. word: what a person has made of it, None, "confirmed", "corrected" or "rejected".

    reviewed: a reviewer has spoken of it. food_is_told: a person has said what it is, or that it is right;
    food_is_guessed: the server alone takes it for this food, by its looks. flags: of the measurement that counts, and
    those named above. run_id: the run that saw its region as it stands, None: none did.
    """

    item: Item
    rings: Sequence[Ring]
    taken_for: ItemFood | None
    amount: Amount
    share: float
    word: RecordStatus | None
    reviewed: bool
    food_is_told: bool
    flags: tuple[str, ...]
    food_is_guessed: bool = False
    run_id: uuid.UUID | None = None

    @property
    def is_live(self) -> bool:
        """Whether it counts as food of the meal."""
        return self.word != "rejected"

    @property
    def stands(self) -> bool:
        """Whether it can be spoken of: nothing has taken its place, and what made it was not undone."""
        return REPLACED not in self.flags and UNDONE not in self.flags


@dataclass(frozen=True, slots=True)
class Word:
    """An event with what it says."""

    event: MealEvent
    value: EventValue

    @property
    def precedence(self) -> tuple[int, int]:
        """Of two, the greater one holds: by layer, then by time."""
        return LAYERS.index(self.event.layer), self.event.sequence


@dataclass(frozen=True, slots=True)
class LeftoverState:
    """An item of the after-meal pair, and what it is of which item. is_by_person: a person said so, and it can be."""

    state: ItemState
    leftover_class: str
    of_item_id: uuid.UUID | None
    flags: tuple[str, ...]
    is_by_person: bool = False


@dataclass(frozen=True, slots=True)
class MealState:
    """A meal's items in their order, what was left of them, and what people said of the meal as a whole.

    answers: item -> the probes that were answered of it, or of what it was made from.
    """

    items: tuple[ItemState, ...]
    leftovers: tuple[LeftoverState, ...]
    answers: Mapping[uuid.UUID, frozenset[str]]
    nothing_left: bool
    is_confirmed: bool


def fold_meal(parts: MealParts) -> MealState:
    """The state that follows from a meal's parts."""
    history = _History(parts)
    states = history.states()
    return MealState(
        items=tuple(state for state in states if state.item.origin != "after"),
        leftovers=tuple(history.leftover(state) for state in states if state.item.origin == "after"),
        answers=history.answers(),
        nothing_left=any(word.event.kind == "nothing_left" for word in history.counting),
        is_confirmed=any(isinstance(word.value, ConfirmMeal) for word in history.counting),
    )


def live_events(events: Sequence[MealEvent]) -> list[Word]:
    """Those that nobody has undone, in their order."""
    undone: set[uuid.UUID] = set()
    live = []
    for event in sorted(events, key=lambda each: each.sequence, reverse=True):
        if event.id in undone:
            continue
        word = read_word(event)
        if isinstance(word.value, Undo):
            undone.add(word.value.event)
        else:
            live.append(word)
    return live[::-1]


def read_word(event: MealEvent) -> Word:
    """The event with its value."""
    return Word(event, value_of(event))


def region_drawn(word: Word, item: Item) -> Region | None:
    """The region (point, box or polygon) that an event drew of an item, to be measured; None if it drew none of it."""
    value, is_made = word.value, item.event_id == word.event.id
    if isinstance(value, Redraw) and word.event.item_id == item.id:
        return Region(polygon=value.polygon)
    if isinstance(value, Add) and is_made:
        return value.region
    if isinstance(value, Split) and is_made:
        polygon = _part_of(value, item).polygon
        return Region(polygon=polygon) if polygon is not None else None
    return None


def lies_as_told(word: Word, item: Item) -> str | None:
    """How an item that the event made was said to lie."""
    if isinstance(word.value, Split):
        return _part_of(word.value, item).lies_as
    return word.value.lies_as if isinstance(word.value, Add) else None


def items_of(word: Word) -> list[uuid.UUID]:
    """The items that must stand for the event to count: the one that it is about, those that it merges."""
    about = [word.event.item_id] if word.event.item_id is not None else []
    return about + (word.value.items if isinstance(word.value, Merge) else [])


class _History:
    """What was said of one meal. counting: the events that count, in their order."""

    def __init__(self, parts: MealParts) -> None:
        self._parts = parts
        self._items = {item.id: item for item in parts.items}
        self._replaced_by: dict[uuid.UUID, Word] = {}
        self._by_id: dict[uuid.UUID, Word] = {}
        self._of_item: dict[uuid.UUID, list[Word]] = {}
        for word in live_events(parts.events):
            if all(self._stands(item_id) for item_id in items_of(word)):
                self._count(word)
        self.counting = list(self._by_id.values())

    def states(self) -> list[ItemState]:
        """The items as they stand, in their order; what was declared of a rejected one goes with it."""
        states = {item.id: self._state(item) for item in self._parts.items}
        for item_id, state in states.items():
            parent = states.get(state.item.parent_id) if state.item.parent_id is not None else None
            is_of_rejected = (
                state.item.origin == "declared" and parent is not None and parent.stands and not parent.is_live
            )
            if is_of_rejected and state.stands:
                states[item_id] = replace(state, word="rejected", flags=(*state.flags, OF_REJECTED))
        return list(states.values())

    def leftover(self, state: ItemState) -> LeftoverState:
        """What an item of the after-meal pair is: of merged items, of the merged one; of a split item, nobody's."""
        rows = [row for row in self._parts.leftovers.get(state.item.id, ()) if self._counts(row.event_id)]
        if not rows:
            return LeftoverState(state, "unmatched", None, ())
        row: Leftover = max(rows, key=lambda each: (LAYERS.index(each.layer), each.version))
        of_item_id = self._successor(row.item_id) if row.item_id is not None else None
        leftover_class = row.leftover_class if of_item_id is not None else "unmatched"
        is_by_person = row.layer != "automatic" and (row.item_id is None or of_item_id is not None)
        return LeftoverState(state, leftover_class, of_item_id, tuple(row.flags), is_by_person)

    def answers(self) -> dict[uuid.UUID, frozenset[str]]:
        """Item -> probes that were answered of it or of the items that it was made from."""
        answers: dict[uuid.UUID, frozenset[str]] = {}
        for item in sorted(self._parts.items, key=lambda each: each.position):
            values = [word.value for word in self._of_item.get(item.id, ())]
            made_by = self._made_by(item)
            made_from = items_of(made_by) if made_by is not None and isinstance(made_by.value, Split | Merge) else []
            own = frozenset(value.probe for value in values if isinstance(value, Declare))
            answers[item.id] = own.union(*(answers.get(each, frozenset()) for each in made_from))
        return answers

    def _count(self, word: Word) -> None:
        event = word.event
        self._by_id[event.id] = word
        if event.item_id is not None:
            self._of_item.setdefault(event.item_id, []).append(word)
        if isinstance(word.value, Split | Merge):
            self._replaced_by |= dict.fromkeys(items_of(word), word)

    def _made_by(self, item: Item) -> Word | None:
        """The event that made it, if one did and it counts."""
        return self._by_id.get(item.event_id) if item.event_id is not None else None

    def _counts(self, event_id: uuid.UUID | None) -> bool:
        return event_id is None or event_id in self._by_id

    def _stands(self, item_id: uuid.UUID) -> bool:
        """Whether the item is there after the events so far."""
        item = self._items.get(item_id)
        return item is not None and self._counts(item.event_id) and item_id not in self._replaced_by

    def _successor(self, item_id: uuid.UUID) -> uuid.UUID | None:
        while item_id in self._replaced_by:
            word = self._replaced_by[item_id]
            if not isinstance(word.value, Merge):
                return None
            item_id = next(item.id for item in self._parts.items if item.event_id == word.event.id)
        return item_id if self._stands(item_id) else None

    def _state(self, item: Item) -> ItemState:
        words = self._of_item.get(item.id, [])
        made_by = self._made_by(item)
        spoken = [word for word in words if word.event.kind in WORDS] + ([made_by] if made_by is not None else [])
        spoken += [
            each for each in self.counting if isinstance(each.value, ConfirmMeal) and item.id in each.value.items
        ]
        taken_for = self._newest_food(item)
        food_key = self._parts.food_keys[taken_for.food_id] if taken_for is not None else None
        measured = _measured(self._parts, item, made_by, words, food_key)
        is_vouched = any(each.event.kind in ("confirm", "confirm_meal") for each in spoken)
        word, flags = _word(spoken), measured.flags
        if item.id in self._replaced_by:
            word, flags = "rejected", (*flags, REPLACED)
        if not self._counts(item.event_id):
            word, flags = "rejected", (*flags, UNDONE)
        return ItemState(
            item=item,
            rings=measured.rings,
            taken_for=taken_for,
            amount=measured.amount,
            share=self._share(item),
            word=word,
            reviewed=any(each.event.layer == "reviewer" for each in spoken),
            food_is_told=is_vouched or (taken_for is not None and taken_for.layer != "automatic"),
            flags=flags,
            food_is_guessed=not is_vouched and self._is_guessed(item, taken_for),
            run_id=measured.run_id,
        )

    def _is_guessed(self, item: Item, taken_for: ItemFood | None) -> bool:
        """Whether the index, and not a hint, says what it is; a part of a guessed item is guessed itself."""
        if taken_for is None or taken_for.layer != "automatic":
            return False
        sources = {candidate.source for candidate in self._parts.candidates.get(item.id, ())}
        return FROM_HINT not in sources and (FROM_INDEX in sources or taken_for.event_id is not None)

    def _share(self, item: Item) -> float:
        """The participant's part of an item; of what was declared without a share, that of the item it came with."""
        made_by = self._made_by(item)
        shares = [
            (word.precedence, word.value.share)
            for word in self._of_item.get(item.id, ())
            if isinstance(word.value, SetShare)
        ]
        first = made_by.value.share if made_by is not None and isinstance(made_by.value, MAKES_ITEMS) else None
        if made_by is not None and isinstance(made_by.value, Add | Declare) and first is not None:
            shares.append((made_by.precedence, first))  # a split or a merge only hands on what the share was
        if shares:
            return max(shares)[1]
        if made_by is not None and isinstance(made_by.value, Declare) and item.parent_id in self._items:
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


AS_FOUND = (-1, 0)  # the precedence of the pipeline's first measurement: before all that people say


def _measured(
    parts: MealParts, item: Item, made_by: Word | None, words: Sequence[Word], food_key: str | None
) -> _Measured:
    """How much there is of an item, and where. food_key: the food that it is taken for.

    The newest region that was drawn counts. Until it is measured the amount stays what it was; where it cannot be
    measured, the amount of the old region is nothing to go by, and only what somebody told stays.
    """
    about = sorted(
        [*([made_by] if made_by is not None else []), *words], key=lambda word: word.precedence, reverse=True
    )
    drawn = [word for word in about if region_drawn(word, item) is not None]
    rows = {row.event_id: row for row in parts.measures.get(item.id, ())}
    answered = rows.keys() | parts.failed_remeasures
    done = next((word for word in drawn if word.event.id in answered), None)
    measured_at, measured = AS_FOUND, _amount_of(item)
    rings: Sequence[Ring] = item.rings
    flags, run_id = list(item.flags), item.run_id
    if done is not None:
        row = rows.get(done.event.id)
        measured_at = done.precedence
        measured = _amount_of(row, done.event.layer) if row is not None else NOTHING_KNOWN
        rings, flags = (row.rings, list(row.flags)) if row is not None else (_rings(done, item), [REMEASURE_FAILED])
        run_id = row.run_id if row is not None else None
    if drawn and drawn[0] is not done:
        rings, flags = _rings(drawn[0], item), [REMEASURING]
    for word in about:
        given = _amount_given(word, item, food_key)
        if given is None:
            continue
        if measured.volume_ml is None or word.precedence > measured_at:
            is_newest = not drawn or word.precedence >= drawn[0].precedence
            kept = [flag for flag in flags if flag == REMEASURING] if is_newest else flags
            return _Measured(_amount_set(given, word, measured), rings, tuple(kept), run_id)
        break  # only the newest counts
    return _Measured(measured, rings, tuple(flags), run_id)


def _rings(word: Word, item: Item) -> Sequence[Ring]:
    """A region as it was drawn; that of an item that the event made is the item's own."""
    return rings_of(word.value.polygon) if isinstance(word.value, Redraw) else item.rings


def _word(spoken: Sequence[Word]) -> RecordStatus | None:
    """What people have made of an item: the last one of the highest layer decides whether it is there."""
    if not spoken:
        return None
    if max(spoken, key=lambda word: word.precedence).event.kind == "reject":
        return "rejected"
    return "corrected" if any(word.event.kind in CORRECTIONS for word in spoken) else "confirmed"


def _part_of(value: Split, item: Item) -> Part:
    """What a split says of one of the items that it made."""
    return next(part for part in value.parts if part.item == item.id)


def _amount_given(word: Word, item: Item, food_key: str | None) -> AmountValue | None:
    """The amount that the event gives the item: a household measure counts for its own food only."""
    value: EventValue | Part = word.value
    is_made = item.event_id == word.event.id
    if isinstance(value, Split) and is_made:
        value = _part_of(value, item)
    if not isinstance(value, SetAmount) and not (is_made and isinstance(value, AmountValue)):
        return None
    is_of_food = value.portion_of in (None, food_key)
    return value if (value.mass_g is not None and is_of_food) or value.volume_ml is not None else None


def _amount_set(given: AmountValue, word: Word, measured: Amount) -> Amount:
    """The amount that an event sets. measured: the volume that is shown beside grams."""
    layer, relative_sd = word.event.layer, given.relative_sd
    if given.mass_g is not None:
        return replace(measured, mass=SetMass(given.mass_g, given.of, relative_sd, given.portion_of), layer=layer)
    if given.volume_ml is None:
        raise ValueError(f"event {word.event.id} gives no amount")
    volume = estimate(given.volume_ml, Doubt(item=relative_sd))
    return Amount(volume.value, volume.low, volume.high, {"item": relative_sd}, layer=layer)


def _amount_of(row: Item | ItemMeasure, layer: str = "automatic") -> Amount:
    return Amount(row.volume_ml, row.volume_low_ml, row.volume_high_ml, row.relative_sd, layer=layer)
