"""Effective records: the projection of a meal's runs and events, written in the transaction of what changed them.

One way for all: a run is saved, a person says something, an after-meal pair comes in, tables are put in force. Each
ends here, and `tada records rebuild` compares with what comes out here.
"""

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy.orm import Session

from app.candidates.item_candidates import ItemCandidates, candidates_of
from app.candidates.project_index import entry_of, write_entries
from app.foods import queries as foods
from app.foods.food_amounts import NO_FOOD, FoodAmounts, Weighing, food_amounts
from app.foods.models import Component, Food
from app.meals import queries as meals
from app.meals.item_state import (
    FOOD_DOUBTFUL,
    FOOD_IDENTIFIED,
    ItemState,
    LeftoverState,
    MealState,
    fold_meal,
)
from app.meals.meal_clock import time_flags
from app.meals.meal_parts import MealParts, parts_of, records_of
from app.meals.models import AFTER_SLOTS, AfterStatus, Meal, MealStatus
from app.meals.queries import UNESTIMATED
from app.meals.record_models import EffectiveRecord, ItemFood, RecordStatus
from app.nutrition.mass import Mass
from app.outbox.announce import announce_meal
from app.records import queries as records
from app.records.item_foods import weighing_of
from app.records.review.review_doubt import UNKNOWN, review_doubt
from app.records.served_mass import served_mass

AFTER_WAITED_FOR = frozenset({None, "receiving", "queued", "processing"})
AFTER_MEASURED = frozenset({"estimated", "needs_review"})
SURE = 0.95  # of the index that a hint names the wrong food: a phone is wrong less often than it is
SETTLED = frozenset({"confirmed", "corrected", "rejected"})


@dataclass(frozen=True, slots=True)
class ItemProjection:
    """An item as it stands, what it amounts to (None: no food), and the effective record's columns but change_seq.

    entry: the columns of its entry in the index; None: it has none.
    """

    state: ItemState
    candidates: ItemCandidates
    amounts: FoodAmounts | None
    columns: Mapping[str, Any]
    entry: Mapping[str, Any] | None


@dataclass(frozen=True, slots=True)
class MealProjection:
    """A meal's items, what was left of them, and the meal's own status. status None: the run decides, or none is."""

    parts: MealParts
    state: MealState
    items: tuple[ItemProjection, ...]
    status: MealStatus | None


class Projector:
    """Projects meals; keeps what it has read of foods, which do not change under way."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._contents: dict[int, Mapping[str, float]] = {}
        self._foods: dict[int, Food] = {}
        self.components: dict[str, Component] = {}

    def project(self, parts: MealParts) -> MealProjection:
        """What follows from the parts of a meal."""
        state = fold_meal(parts)
        self._read_foods(parts, state)
        left = _Leftovers(parts, state)
        items = tuple(self._item(parts, each, left) for each in state.items)
        return MealProjection(parts, state, items, _status(parts, state, items))

    def food(self, food_id: int) -> Food:
        """A version of a food."""
        if food_id not in self._foods:
            self._foods[food_id] = self._session.get_one(Food, food_id)
        return self._foods[food_id]

    def contents(self, food_id: int) -> Mapping[str, float]:
        """Component number -> content of 100 g edible portion."""
        if food_id not in self._contents:
            known = foods.nutrients_of(self._session, food_id)
            self._contents[food_id] = {row.component.number: row.per_100_g for row in known}
            self.components |= {row.component.number: row.component for row in known}
        return self._contents[food_id]

    def _read_foods(self, parts: MealParts, state: MealState) -> None:
        """Read in two queries what the items of a meal need and is not known yet."""
        taken_for = {each.taken_for.food_id for each in state.items if each.taken_for is not None}
        named = taken_for | {one.food_id for candidates in parts.candidates.values() for one in candidates}
        self._foods |= {food.id: food for food in foods.foods_by_id(self._session, named - self._foods.keys())}
        for food_id, known in foods.nutrients_of_each(self._session, taken_for - self._contents.keys()).items():
            self._contents[food_id] = {row.component.number: row.per_100_g for row in known}
            self.components |= {row.component.number: row.component for row in known}

    def _item(self, parts: MealParts, state: ItemState, leftovers: "_Leftovers") -> ItemProjection:
        taken_for, candidates = state.taken_for, candidates_of(parts, state)
        of_food = self._food_flags(state, candidates)
        flags = [*state.flags, *leftovers.flags_of(state), *time_flags(parts.meal)]
        amounts = None
        if taken_for is not None and state.is_live:
            weighing = weighing_of(taken_for)
            is_by_volume = state.amount.mass is None
            amounts = food_amounts(
                self.food(taken_for.food_id).key,
                self.contents(taken_for.food_id),
                weighing if is_by_volume else replace(weighing, density=None),
                served_mass(weighing, state.amount),
                left=leftovers.masses(state, weighing),
                share=state.share,
            )
        meal, status = parts.meal, _record_status(state, amounts)
        columns = {
            "item_id": state.item.id,
            "meal_id": meal.id,
            "study_id": meal.study_id,
            "participant_id": meal.participant_id,
            "captured_at": meal.captured_at,
            "local_date": meal.local_date,
            "status": status,
            "origin": state.item.origin,
            "provisional": is_provisional(meal),
            "reviewed": state.reviewed,
            "food_id": taken_for.food_id if taken_for is not None else None,
            "volume_ml": state.amount.volume_ml,
            "volume_low_ml": state.amount.volume_low_ml,
            "volume_high_ml": state.amount.volume_high_ml,
            "share": state.share,
            **(amounts.record_columns() if amounts is not None else NO_FOOD),
            "flags": [*flags, *of_food],
            "doubt": 0.0,
        }
        if state.is_live:  # what the flags of the food say is in the probability already
            columns["doubt"] = _doubt(self._probability(state, candidates) if of_food else 1.0, amounts, flags)
        food_key = self.food(taken_for.food_id).key if taken_for is not None else None
        entry = entry_of(parts, state, status, food_key)
        return ItemProjection(state, candidates, amounts, columns, entry)

    def _food_flags(self, state: ItemState, candidates: ItemCandidates) -> list[str]:
        """Why the food may be another one, as long as no person has said or seen what it is."""
        if state.taken_for is None or state.food_is_told or not state.is_live:
            return []
        if state.food_is_guessed:
            return [FOOD_IDENTIFIED]
        best = next(iter(candidates.by_index), None)
        is_other = best is not None and self.food(best.food_id).key != self.food(state.taken_for.food_id).key
        return [FOOD_DOUBTFUL] if is_other and best is not None and (best.probability or 0.0) >= SURE else []

    def _probability(self, state: ItemState, candidates: ItemCandidates) -> float:
        """Of the food that the item is taken for, by whichever version, as the index sees it."""
        if state.taken_for is None:
            return 0.0
        key = self.food(state.taken_for.food_id).key
        return next((one.probability or 0.0 for one in candidates.by_index if self.food(one.food_id).key == key), 0.0)


class _Leftovers:
    """What was left of each item of one meal."""

    def __init__(self, parts: MealParts, state: MealState) -> None:
        self._state = state
        self._is_measured = parts.after_run is not None and parts.meal.after_status in AFTER_MEASURED
        self._has_failed = parts.meal.after_status == "failed"
        self._live = [each for each in state.leftovers if each.state.is_live]

    def masses(self, item: ItemState, weighing: Weighing) -> list[Mass | None] | None:
        """Masses of what was left of an item, by the item's own density; None: nobody has looked."""
        if not self._is_measured:
            return [] if self._state.nothing_left else None
        if item.item.origin == "declared" and not self._of(item):
            return None  # no camera sees it, so its pieces were not looked for
        left = [each for each in self._of(item) if each.leftover_class == "food_left"]
        return [served_mass(weighing, each.state.amount) for each in left]

    def flags_of(self, item: ItemState) -> Iterable[str]:
        """What a person should know of the leftovers of this item, and of those that are nobody's."""
        if self._has_failed and not self._state.nothing_left:
            yield "after_failed"
        if not self._is_measured:
            return
        yield from dict.fromkeys(flag for each in self._of(item) for flag in each.flags)
        if any(each.leftover_class == "food_left" and _is_unknown(each) for each in self._of(item)):
            yield "leftover_not_measurable"
        if any(each.leftover_class == "unmatched" and not each.is_by_person for each in self._live):
            yield "leftover_unmatched"

    def _of(self, item: ItemState) -> list[LeftoverState]:
        return [each for each in self._live if each.of_item_id == item.item.id]


def is_provisional(meal: Meal) -> bool:
    """Whether the meal's records may still change by an after-meal pair."""
    return meal.after_due_at is not None and meal.after_status in AFTER_WAITED_FOR


def project_meal(session: Session, meal: Meal, projector: Projector | None = None) -> MealProjection:
    """Write the meal's records and status as they follow from all that is in the session by now.

    The meal is locked by the caller. Records that do not change keep their place in the order of changes.
    """
    session.flush()
    parts = _with_after_pair_settled(session, parts_of(session, [meal])[0])
    projection = (projector or Projector(session)).project(parts)
    write_records(session, projection)
    has_moved = projection.status is not None and projection.status != meal.status
    if projection.status is not None:
        meal.status = projection.status
    meal.version += 1
    if has_moved:
        announce_meal(session, meal)
    return projection


def write_records(session: Session, projection: MealProjection) -> int:
    """Write those records of a meal that differ from what they should be, as one change, and entries of the index.

    Returns of how many items one or the other did.
    """
    meal_id = projection.parts.meal.id
    moved = write_entries(session, meal_id, entries_wanted(projection))
    here = records_of(session, meal_id)
    found = [(here.get(item.state.item.id), item.columns) for item in projection.items]
    wanted = [(record, columns) for record, columns in found if record is None or differences(record, columns)]
    if not wanted:
        return len(moved)
    change_seq = records.next_change_seq(session, projection.parts.meal.study_id)
    for record, columns in wanted:
        if record is None:
            session.add(EffectiveRecord(**columns, change_seq=change_seq))
            continue
        for name, value in columns.items():
            setattr(record, name, value)
        record.change_seq = change_seq
    return len(moved.union(columns["item_id"] for _, columns in wanted))


def differences(record: EffectiveRecord, columns: Mapping[str, Any]) -> list[str]:
    """Names of the columns that are not as they should be."""
    return [name for name, value in columns.items() if getattr(record, name) != value]


def entries_wanted(projection: MealProjection) -> dict[uuid.UUID, Mapping[str, Any] | None]:
    """Item -> the columns of its entry in the index, None where it is to have none."""
    return {item.state.item.id: item.entry for item in projection.items}


def with_food(parts: MealParts, row: ItemFood, key: str) -> MealParts:
    """The parts as they would be with one more row of what an item is taken for; key: of its food."""
    rows = [*parts.foods.get(row.item_id, ()), row]
    food_keys = parts.food_keys | {row.food_id: key}
    return replace(parts, foods={**parts.foods, row.item_id: rows}, food_keys=food_keys)


def _doubt(probability: float, amounts: FoodAmounts | None, flags: Sequence[str]) -> float:
    """Of an item that counts. probability: that it is the food that it is taken for."""
    if amounts is None or amounts.mass is None:
        return UNKNOWN
    return review_doubt(probability, amounts.consumed_g, amounts.mass.edible_g.value * amounts.share, flags)


def _record_status(state: ItemState, amounts: FoodAmounts | None) -> RecordStatus:
    if state.word == "rejected":
        return "rejected"
    if amounts is None or amounts.consumed_g is None:
        return "needs_review"  # whatever was said of it, how much was eaten is not known
    return state.word or "proposed"


def _status(parts: MealParts, state: MealState, items: Sequence[ItemProjection]) -> MealStatus | None:
    """The meal's status where a run or a person has spoken: it is confirmed when a person has settled all of it."""
    meal, run = parts.meal, parts.run
    if meal.status in UNESTIMATED and meal.origin == "photographed" and (run is None or parts.waits_for_run):
        return None
    statuses = [item.columns["status"] for item in items if item.state.stands]
    if "needs_review" in statuses:
        return "needs_review"
    if all(status in SETTLED for status in statuses) and (statuses or state.is_confirmed):
        return "confirmed"
    if not statuses and (run.failure_code if run is not None else meal.failure_code) is not None:
        return "failed"
    return "estimated" if statuses else "needs_review"


def _with_after_pair_settled(session: Session, parts: MealParts) -> MealParts:
    """The parts with the pieces matched and the after-meal pair's status in line: the records follow from both."""
    meal, has_pieces = parts.meal, any(item.origin == "after" for item in parts.items)
    is_spoken_of = any(event.kind == "nothing_left" for event in parts.events)
    if not (has_pieces or is_spoken_of or meal.after_status in AFTER_MEASURED):
        return parts
    state = fold_meal(parts)
    if has_pieces:
        # NumPy and SciPy come with it: 50 MB that an API process has no other use for
        from app.records.match_leftovers import match_leftovers  # noqa: PLC0415

        if match_leftovers(session, parts, state):
            session.flush()
            parts = parts_of(session, [meal])[0]
            state = fold_meal(parts)
    meal.after_status = _after_status(session, meal, state)
    return parts


def _after_status(session: Session, meal: Meal, state: MealState) -> AfterStatus | None:
    """Where the after-meal pair stands: a run or an upload has moved it, what people say may end the wait for it."""
    if meal.after_status in AFTER_MEASURED:
        is_open = any(_is_open(each) for each in state.leftovers if each.state.is_live)
        return "needs_review" if is_open else "estimated"
    if state.nothing_left:
        return "nothing_left" if meal.after_status in (None, "receiving", "failed") else meal.after_status
    if meal.after_status != "nothing_left":
        return meal.after_status
    if meal.after_failure_code is not None:  # the word was taken back: as it was before
        return "failed"
    has_come = any(image.slot in AFTER_SLOTS for image in meals.images_of(session, meal.id))
    return "receiving" if has_come or meal.after_details is not None else None


def _is_open(leftover: LeftoverState) -> bool:
    """Whether a person must say of which item a piece is, or how much of it there is."""
    if leftover.leftover_class == "unmatched":
        return not leftover.is_by_person
    return leftover.leftover_class == "food_left" and _is_unknown(leftover)


def _is_unknown(leftover: LeftoverState) -> bool:
    return leftover.state.amount.volume_ml is None and leftover.state.amount.mass is None
