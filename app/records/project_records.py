"""Effective records: the projection of a meal's runs and events, written in the transaction of what changed them.

One way for all: a run is saved, a person says something, an after-meal pair comes in, tables are
put in force. Each ends here. Reads use what is stored; `tada records rebuild` compares it with what
comes out here.

Entries of the index are projected along: there is one while the item's record is confirmed or
corrected, a person has said or seen what it is, and the run that saw its region as it stands has
described it.
"""

import uuid
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy.orm import Session

from app.candidates import queries as index_entries
from app.candidates.item_candidates import current_candidates
from app.core.believable import is_implausible
from app.db.base import Base
from app.foods import queries as foods
from app.foods.food_amounts import NO_FOOD, FoodAmounts, Weighing, food_amounts, mass_of
from app.foods.models import Food
from app.meals.stored import queries as meals
from app.meals.stored.announce import announce_meal
from app.meals.stored.identification_models import IndexEntry
from app.meals.stored.item_state import (
    FOOD_DOUBTFUL,
    FOOD_IDENTIFIED,
    IMPLAUSIBLE_AMOUNT,
    ItemState,
    LeftoverState,
    MealState,
    fold_meal,
)
from app.meals.stored.meal_parts import FROM_INDEX, MealParts, parts_of, records_of
from app.meals.stored.meal_time import local_minute, time_flags
from app.meals.stored.models import AfterStatus, Meal, MealStatus, PieceDetails
from app.meals.stored.queries import UNESTIMATED
from app.meals.stored.record_models import (
    EffectiveRecord,
    ItemCandidate,
    ItemFood,
    MassDoubt,
    RecordDetails,
    RecordStatus,
)
from app.nutrition.mass import Mass
from app.photos.slots import AFTER_SLOTS
from app.records import queries as records
from app.records.item_foods import served_mass, weighing_of
from app.records.review.review_doubt import UNKNOWN, review_doubt

AFTER_WAITED_FOR = frozenset({None, "receiving", "queued", "processing"})
AFTER_MEASURED = frozenset({"estimated", "needs_review"})
SURE = 0.95  # of the index that a hint names the wrong food: a phone is wrong less often than it is
SETTLED = frozenset({"confirmed", "corrected", "rejected"})
LEARNED = frozenset({"confirmed", "corrected"})  # record's statuses
NEVER_LEARNED = frozenset({"after", "declared"})  # pieces that were left, and what no camera saw
# columns that readers of changes do not get
UNSEEN = frozenset({"food_version", "run_id", "details"})

Columns = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ItemProjection:
    """An item as it stands, and the effective record's columns but change_seq.

    entry: the columns of its entry in the index; None: it has none.
    """

    state: ItemState
    columns: Columns
    entry: Columns | None


@dataclass(frozen=True, slots=True)
class MealProjection:
    """A meal's items, what was left of them, and the meal's own status.

    status None: the run decides, or none is.
    """

    parts: MealParts
    items: tuple[ItemProjection, ...]
    leftovers: list[PieceDetails]
    status: MealStatus | None


class Projector:
    """Projects meals; keeps what it has read of foods, which do not change under way."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._contents: dict[int, Mapping[str, float]] = {}
        self._foods: dict[int, Food] = {}

    def project(self, parts: MealParts) -> MealProjection:
        """What follows from the parts of a meal."""
        state = fold_meal(parts)
        self._read_foods(parts, state)
        left = _Leftovers(parts, state)
        items = tuple(
            self._item(parts, each, left, state.answers[each.item.id]) for each in state.items
        )
        assignments: dict[uuid.UUID | None, ItemFood | None] = {
            each.item.id: each.food_assignment for each in state.items
        }
        pieces = [
            self._piece(each, assignments.get(each.of_item_id, each.state.food_assignment))
            for each in state.leftovers
        ]
        return MealProjection(parts, items, pieces, _status(parts, state, items))

    def food(self, food_id: int) -> Food:
        """A version of a food."""
        if food_id not in self._foods:
            self._foods[food_id] = self._session.get_one(Food, food_id)
        return self._foods[food_id]

    def contents(self, food_id: int) -> Mapping[str, float]:
        """Component number -> content of 100 g edible portion."""
        if food_id not in self._contents:
            self._read_contents({food_id})
        return self._contents[food_id]

    def _read_contents(self, food_ids: set[int]) -> None:
        for food_id, rows in foods.nutrients_of_each(
            self._session, food_ids - self._contents.keys()
        ).items():
            self._contents[food_id] = {row.component.number: row.per_100_g for row in rows}

    def _read_foods(self, parts: MealParts, state: MealState) -> None:
        """Read in two queries what the items of a meal need and is not known yet."""
        assigned = {
            each.food_assignment.food_id for each in state.items if each.food_assignment is not None
        }
        named = assigned | {
            row.food_id for candidates in parts.candidates.values() for row in candidates
        }
        self._foods |= {
            food.id: food for food in foods.foods_by_id(self._session, named - self._foods.keys())
        }
        self._read_contents(assigned)

    def _item(
        self, parts: MealParts, state: ItemState, leftovers: "_Leftovers", answers: frozenset[str]
    ) -> ItemProjection:
        food_assignment, meal = state.food_assignment, parts.meal
        food = self.food(food_assignment.food_id) if food_assignment is not None else None
        by_index = self._by_index(parts, state)
        of_food = self._food_flags(state, by_index)
        flags = [
            *state.flags,
            *leftovers.flags_of(state),
            *time_flags(meal.origin, meal.captured_at, meal.received_at),
        ]
        if _is_implausible(
            state, weighing_of(food_assignment) if food_assignment is not None else None
        ):
            flags.append(IMPLAUSIBLE_AMOUNT)
        amounts = None
        if food_assignment is not None and food is not None and state.is_live:
            weighing = weighing_of(food_assignment)
            is_by_volume = state.amount.mass is None
            amounts = food_amounts(
                food.key,
                self.contents(food.id),
                weighing if is_by_volume else replace(weighing, density=None),
                served_mass(weighing, state.amount),
                left=leftovers.masses(state, weighing),
                share=state.share,
            )
        status = _record_status(
            state, amounts, is_doubtful=IMPLAUSIBLE_AMOUNT in flags and not state.reviewed
        )
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
            "reviewed": state.reviewed and status != "needs_review",
            "food_id": food.id if food is not None else None,
            "food_version": food_assignment.version if food_assignment is not None else None,
            "run_id": state.run_id,
            "volume_ml": state.amount.volume_ml,
            "volume_low_ml": state.amount.volume_low_ml,
            "volume_high_ml": state.amount.volume_high_ml,
            "share": state.share,
            **(amounts.record_columns() if amounts is not None else NO_FOOD),
            "flags": [*flags, *of_food],
            "doubt": 0.0,
            "details": _details(state, amounts, food, answers),
        }
        if state.is_live:  # what the flags of the food say is in the probability already
            columns["doubt"] = _doubt(
                self._probability(state, by_index) if of_food else 1.0, amounts, flags
            )
        return ItemProjection(state, columns, _entry(parts, state, status, food))

    def _piece(self, leftover: LeftoverState, food_assignment: ItemFood | None) -> PieceDetails:
        """A piece of the after-meal pair. food_assignment: by which it is weighed."""
        state, amount = leftover.state, leftover.state.amount
        food = self.food(food_assignment.food_id) if food_assignment is not None else None
        mass = (
            served_mass(weighing_of(food_assignment), amount)
            if food_assignment is not None
            else None
        )
        low_ml, high_ml = amount.volume_low_ml, amount.volume_high_ml
        return {
            "id": str(state.item.id),
            "item": str(leftover.of_item_id) if leftover.of_item_id is not None else None,
            "class": leftover.leftover_class,
            "is_by_person": leftover.is_by_person,
            "polygon": list(state.rings),
            "food": {"key": food.key, "name": food.name} if food is not None else None,
            "volume_ml": amount.volume_ml,
            "volume_interval_ml": [low_ml, high_ml]
            if low_ml is not None and high_ml is not None
            else None,
            "mass_g": mass.as_seen_g.value if mass is not None else None,
            "mass_interval_g": [mass.as_seen_g.low, mass.as_seen_g.high]
            if mass is not None
            else None,
            "flags": [*state.flags, *leftover.flags],
        }

    def _by_index(self, parts: MealParts, state: ItemState) -> list[ItemCandidate]:
        """The index's candidates for the item's region as it stands, best first."""
        item_id = state.item.id
        rows, _ = current_candidates(
            parts.candidates.get(item_id, ()),
            parts.identified.get(item_id, ()),
            seen_by=state.run_id,
            found_by=state.item.run_id,
        )
        return [row for row in rows if row.source == FROM_INDEX]

    def _food_flags(self, state: ItemState, by_index: Sequence[ItemCandidate]) -> list[str]:
        """Why the food may be another one, as long as no person has said or seen what it is."""
        if state.food_assignment is None or state.is_food_confirmed or not state.is_live:
            return []
        if state.is_food_guessed:
            return [FOOD_IDENTIFIED]
        foods = [row for row in by_index if not self.food(row.food_id).is_group]
        if not foods or (foods[0].probability or 0.0) < SURE:
            return []
        is_other = self.food(foods[0].food_id).key != self.food(state.food_assignment.food_id).key
        return [FOOD_DOUBTFUL] if is_other else []

    def _probability(self, state: ItemState, by_index: Sequence[ItemCandidate]) -> float:
        """Of the food that the item is taken for, by whichever version, as the index sees it."""
        if state.food_assignment is None:
            return 0.0
        key = self.food(state.food_assignment.food_id).key
        return next(
            (row.probability or 0.0 for row in by_index if self.food(row.food_id).key == key), 0.0
        )


class _Leftovers:
    """What was left of each item of one meal."""

    def __init__(self, parts: MealParts, state: MealState) -> None:
        self._state = state
        self._is_measured = (
            parts.after_run is not None and parts.meal.after_status in AFTER_MEASURED
        )
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


def project_meal(session: Session, meal: Meal) -> None:
    """Write the meal's records and status as they follow from all that is in the session by now.

    The meal is locked by the caller. Records that do not change keep their place in the order of
    changes.
    """
    session.flush()
    parts = _with_after_pair_settled(session, parts_of(session, [meal])[0])
    projection = Projector(session).project(parts)
    write_records(session, projection)
    has_moved = projection.status is not None and projection.status != meal.status
    if projection.status is not None:
        meal.status = projection.status
    meal.version += 1
    if has_moved:
        announce_meal(session, meal)


def write_records(session: Session, projection: MealProjection) -> int:
    """Write those rows of a meal's projection that differ from what they should be, the records as one change.

    A record whose entry in the index differs is part of that change. Returns of how many items one
    did.
    """
    meal = projection.parts.meal
    stale = _stale_entries(session, projection)
    moved = set(stale)
    for entry, entry_now in stale.values():
        _put(session, IndexEntry, entry, entry_now)
    if meal.leftovers != projection.leftovers:
        moved |= _stale_pieces(projection)
        meal.leftovers = projection.leftovers
    change_seq: int | None = None
    for record, columns in _stale_records(session, projection, stale):
        item_id = columns["item_id"]
        moved.add(item_id)
        is_unseen = record is not None and UNSEEN.issuperset(differences(record, columns))
        if item_id in stale or not is_unseen:  # identify.py finds the entry by the record's number
            if change_seq is None:
                change_seq = records.next_change_seq(session, meal.study_id)
            columns = {**columns, "change_seq": change_seq}  # noqa: PLW2901
        _put(session, EffectiveRecord, record, columns)
    return len(moved)


def count_stale(session: Session, projection: MealProjection) -> int:
    """Of how many items of a meal what is stored is not what write_records would write."""
    moved = set(_stale_entries(session, projection)) | _stale_pieces(projection)
    return len(
        moved.union(columns["item_id"] for _, columns in _stale_records(session, projection))
    )


def differences(row: Base, columns: Columns) -> list[str]:
    """Names of the columns that are not as they should be."""
    return [name for name, value in columns.items() if getattr(row, name) != value]


def _put(session: Session, table: type[Base], row: Base | None, columns: Columns | None) -> None:
    """Give the row these columns; make it where there is none, delete it where there are to be none."""
    if row is None:
        session.add(table(**columns or {}))
    elif columns is None:
        session.delete(row)
    else:
        for name, value in columns.items():
            setattr(row, name, value)


def _stale_records(
    session: Session, projection: MealProjection, relearned: Collection[uuid.UUID] = ()
) -> list[tuple[EffectiveRecord | None, Columns]]:
    """(the record that is there, the columns that it should have) of the items where they differ.

    relearned: also these items, whose entries differ
    """
    stored = records_of(session, projection.parts.meal.id)
    pairs = [(stored.get(item.state.item.id), item.columns) for item in projection.items]
    return [
        (record, columns)
        for record, columns in pairs
        if record is None or columns["item_id"] in relearned or differences(record, columns)
    ]


def _stale_entries(
    session: Session, projection: MealProjection
) -> dict[uuid.UUID, tuple[IndexEntry | None, Columns | None]]:
    """Item -> (its entry in the index, the columns that it should have; None: no entry), where they differ."""
    stored = index_entries.entries_of_meal(session, projection.parts.meal.id)
    projected = {item.state.item.id: item.entry for item in projection.items}
    pairs = {
        item_id: (stored.get(item_id), projected.get(item_id)) for item_id in {*stored, *projected}
    }
    return {
        item_id: (entry, columns)
        for item_id, (entry, columns) in pairs.items()
        if (entry is None) != (columns is None)
        or (entry is not None and columns and differences(entry, columns))
    }


def _stale_pieces(projection: MealProjection) -> set[uuid.UUID]:
    """The pieces of the after-meal pair that are stored otherwise, or not at all."""
    stored = {piece["id"]: piece for piece in projection.parts.meal.leftovers}
    projected = {piece["id"]: piece for piece in projection.leftovers}
    return {
        uuid.UUID(name) for name in {*stored, *projected} if stored.get(name) != projected.get(name)
    }


def with_food(parts: MealParts, row: ItemFood, key: str) -> MealParts:
    """The parts as they would be with one more row of what an item is taken for; key: of its food."""
    rows = [*parts.foods.get(row.item_id, ()), row]
    food_keys = parts.food_keys | {row.food_id: key}
    return replace(parts, foods={**parts.foods, row.item_id: rows}, food_keys=food_keys)


def _details(
    state: ItemState, amounts: FoodAmounts | None, food: Food | None, answers: frozenset[str]
) -> RecordDetails:
    is_own, probes = (
        state.rings == state.item.rings,
        food.probes if food is not None and state.is_live else (),
    )
    return {
        "rings": None if is_own else list(state.rings),
        "served": _term(amounts.mass) if amounts is not None and amounts.mass is not None else None,
        "left": [_term(mass) for mass in amounts.left or ()] if amounts is not None else [],
        "open_probes": [probe for probe in probes if probe not in answers],
    }


def _term(mass: Mass) -> MassDoubt:
    doubt = mass.doubt
    return {
        "edible_g": mass.edible_g.value,
        "pair": doubt.pair,
        "density": doubt.density,
        "item": doubt.item,
    }


def _entry(parts: MealParts, state: ItemState, status: str, food: Food | None) -> Columns | None:
    """The columns of the item's entry in the index, None where it has none.

    status: its record's.
    """
    item, meal = state.item, parts.meal
    seen = [each for each in parts.identified.get(item.id, ()) if each.run_id == state.run_id]
    is_learned = state.is_live and state.stands and status in LEARNED and state.is_food_confirmed
    if not seen or not is_learned or item.origin in NEVER_LEARNED:
        return None
    if food is None or food.is_group:
        return None
    newest = seen[-1]
    return {
        "item_id": item.id,
        "run_id": newest.run_id,
        "vcm_version": newest.vcm_version,
        "study_id": meal.study_id,
        "participant_id": meal.participant_id,
        "food_key": food.key,
        "volume_ml": state.amount.volume_ml,
        "captured_at": meal.captured_at,
        "day_minute": local_minute(meal.captured_at, meal.time_zone),
    }


def _doubt(probability: float, amounts: FoodAmounts | None, flags: Sequence[str]) -> float:
    """Of an item that counts. probability: that it is the food that it is taken for."""
    if amounts is None or amounts.mass is None:
        return UNKNOWN
    return review_doubt(
        probability, amounts.consumed_g, amounts.mass.edible_g.value * amounts.share, flags
    )


def _is_implausible(state: ItemState, weighing: Weighing | None) -> bool:
    """Return whether a person stated an implausible amount."""
    stated = state.amount
    if stated.layer == "automatic":
        return False
    if stated.mass is None:
        return stated.volume_ml is not None and is_implausible(stated.volume_ml, state.measured_ml)
    served = served_mass(weighing, stated) if weighing is not None else None
    measured = mass_of(weighing, state.measured_ml, {}) if weighing is not None else None
    return is_implausible(
        served.as_seen_g.value if served is not None else stated.mass.mass_g,
        measured.as_seen_g.value if measured is not None else None,
    )


def _record_status(
    state: ItemState, amounts: FoodAmounts | None, *, is_doubtful: bool
) -> RecordStatus:
    if state.decision == "rejected":
        return "rejected"
    if amounts is None or amounts.consumed_g is None or is_doubtful:
        return "needs_review"  # whatever was said of it, how much was eaten is not known
    return state.decision or "proposed"


def _status(
    parts: MealParts, state: MealState, items: Sequence[ItemProjection]
) -> MealStatus | None:
    """The meal's status where a run or a person has spoken: it is confirmed when a person has settled all of it."""
    meal, run = parts.meal, parts.run
    if (
        meal.status in UNESTIMATED
        and meal.origin == "photographed"
        and (run is None or parts.waits_for_run)
    ):
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
        from app.records.match_items import match_leftovers  # noqa: PLC0415

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
        return (
            "nothing_left"
            if meal.after_status in (None, "receiving", "failed")
            else meal.after_status
        )
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
