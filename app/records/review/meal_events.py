"""People's words about a meal into its history: one way for all kinds, and whatever follows from a word with it.

An event is checked against the meal as it stands, appended with its old and new values, noted in the audit log and the
meal's records projected anew, in one transaction under the meal's lock. What a kind may say and what it brings about is
its rule (records/review/event_rules.py); here is what holds for all: who may speak, of which version, and once.
"""

import hashlib
import json
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import groupby
from typing import Any

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotAllowedError, NotFoundError, PreconditionFailedError
from app.db.base import Base
from app.db.session import Database
from app.jobs.queue import JobQueue
from app.meals import queries as meals
from app.meals.event_models import MealEvent
from app.meals.item_state import ItemState, MealState, fold_meal
from app.meals.job_models import Job
from app.meals.meal_parts import MealParts, parts_of
from app.meals.models import Meal
from app.meals.record_models import EffectiveRecord, Item
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.records.locked_meal import lock_meal_of
from app.records.project_records import project_meal
from app.records.read_meal import MealView, meal_view

MAX_EVENTS = 1000  # of a meal; each word reads them all
MAX_ITEMS = 200  # of a meal, those that were split, merged and undone as well


@dataclass(frozen=True, slots=True)
class NewEvent:
    """What somebody wants to say. id: made by the client, once an event. told: the request's other fields, JSON."""

    id: uuid.UUID
    kind: str
    item_id: uuid.UUID | None = None
    told: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sha256(self) -> str:
        """Of all that it says: the same event sent again is the same."""
        item = str(self.item_id) if self.item_id is not None else None
        said = json.dumps([self.kind, item, self.told], sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(said.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Standing:
    """The meal as it stands before the event, for the event's rule. layer: of the one who speaks."""

    session: Session
    meal: Meal
    parts: MealParts
    state: MealState
    event: NewEvent
    layer: str
    now: datetime

    def item(self, item_id: uuid.UUID | None = None) -> ItemState:
        """The item that the event is about (or another of the meal), if it can still be spoken of.

        Raises NotFoundError if the meal has no such item, ConflictError if it was replaced or undone.
        """
        wanted = item_id if item_id is not None else self.event.item_id
        for state in self.state.items:
            if state.item.id == wanted:
                if not state.stands:
                    raise ConflictError(
                        "This item was split, merged or undone since: GET the meal to see what stands in its place.",
                        code="item_replaced",
                        item=str(wanted),
                    )
                return state
        raise NotFoundError("This meal has no such item.", code="item_not_found")

    def item_or_piece(self) -> ItemState:
        """The item or the piece of the after-meal pair that the event is about. Raises as `item`."""
        pieces = (piece.state for piece in self.state.leftovers)
        return next((piece for piece in pieces if piece.item.id == self.event.item_id), None) or self.item()

    def record(self, state: ItemState) -> EffectiveRecord:
        """The item's effective record by now."""
        return self.session.get_one(EffectiveRecord, state.item.id)


@dataclass(frozen=True, slots=True)
class Change:
    """What an event amounts to: its old and new values in the words of the API, and the rows that it brings.

    rows: inserted behind the event in this order; a Job among them is queued.
    """

    new: Mapping[str, Any] = field(default_factory=dict)
    old: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[Base] = ()


@dataclass(frozen=True, slots=True)
class EventRule:
    """What events of a kind do. carry_out: raises a TadaError where it cannot be.

    before_estimate: it may come while the meal is not estimated yet. layers: who may say it.
    """

    carry_out: Callable[[Standing], Change]
    before_estimate: bool = False
    layers: Collection[str] = ("participant", "reviewer")


class MealEvents:
    """The use case; one a process. rules: by kind."""

    def __init__(self, database: Database, queue: JobQueue, rules: Mapping[str, EventRule]) -> None:
        self._database = database
        self._queue = queue
        self._rules = rules

    def append(
        self,
        caller: Caller,
        client_id: uuid.UUID,
        event: NewEvent,
        *,
        expected: frozenset[int] | None,
        participant_code: str | None = None,
    ) -> tuple[MealView, bool]:
        """The meal with the event, and whether it is new: the same sent again changes nothing.

        expected: versions of the meal that the caller may have read; None: whichever it is.
        Raises NotFoundError, NotAllowedError, ConflictError, InvalidInputError, PreconditionFailedError, GoneError
        (`withdrawn`: the phone's participant left meanwhile).
        """
        try:
            return self._append(caller, client_id, event, expected, participant_code)
        except IntegrityError:  # the same id at the same time for another meal, which was first
            return self._append(caller, client_id, event, expected, participant_code)

    def _append(
        self,
        caller: Caller,
        client_id: uuid.UUID,
        event: NewEvent,
        expected: frozenset[int] | None,
        participant_code: str | None,
    ) -> tuple[MealView, bool]:
        with self._database.write() as session:
            locked = lock_meal_of(session, caller, client_id, participant_code)
            meal, participant, study = locked.meal, locked.participant_code, locked.study_code
            known = session.get(MealEvent, event.id)
            if known is not None:
                _require_same(known, meal, caller, event)
                return meal_view(session, meal, participant, study), False
            if expected is not None and meal.version not in expected:
                raise PreconditionFailedError(
                    "The meal has changed since you read it: GET it again, then say what still holds.",
                    version=meal.version,
                )
            parts = parts_of(session, [meal])[0]  # held to the end, so that its rows need not be made again
            self._write(session, caller, parts, event)
            project_meal(session, meal)
            return meal_view(session, meal, participant, study), True

    def _write(self, session: Session, caller: Caller, parts: MealParts, event: NewEvent) -> None:
        meal, rule, layer = parts.meal, self._rules[event.kind], layer_of(caller)
        if layer not in rule.layers:
            raise NotAllowedError(f"A {layer} does not say this: {event.kind}.", code="event_not_yours")
        if meal.status in meals.UNESTIMATED and not rule.before_estimate:
            raise ConflictError(
                "The meal is not estimated yet: wait until it is (GET it with ?wait=).",
                code="meal_not_estimated",
                meal_status=meal.status,
            )
        if len(parts.events) >= MAX_EVENTS:
            raise ConflictError(f"{MAX_EVENTS} events are all that a meal takes.", code="events_too_many")
        now = datetime.now(UTC)
        change = rule.carry_out(Standing(session, meal, parts, fold_meal(parts), event, layer, now))
        made = sum(isinstance(row, Item) for row in change.rows)
        if made and len(parts.items) + made > MAX_ITEMS:
            raise ConflictError(f"{MAX_ITEMS} items are all that a meal takes.", code="items_too_many")
        sequence = 1 + max((each.sequence for each in parts.events), default=0)
        insert_event(session, caller, meal, event, change, sequence=sequence, now=now)
        for row in change.rows:
            if isinstance(row, Job):
                self._queue.enqueue(session, row)
        audit.note(session, caller, "meal.event", study_id=meal.study_id, subject=meal.alias, kind=event.kind)


def insert_event(
    session: Session, caller: Caller, meal: Meal, event: NewEvent, change: Change, *, sequence: int, now: datetime
) -> None:
    """Write an event and the rows that it brings."""
    session.add(
        MealEvent(
            id=event.id,
            meal_id=meal.id,
            sequence=sequence,
            item_id=event.item_id,
            kind=event.kind,
            layer=layer_of(caller),
            device_id=caller.device_id if isinstance(caller, DeviceCaller) else None,
            staff_id=caller.staff_id if isinstance(caller, StaffCaller) else None,
            old=dict(change.old),
            new=dict(change.new),
            request_sha256=event.sha256,
            created_at=now,
        )
    )
    session.flush()
    for _, rows in groupby(change.rows, key=type):  # rows refer to those before them
        session.add_all(rows)
        session.flush()


def layer_of(caller: Caller) -> str:
    """In whose name a caller speaks."""
    return "participant" if isinstance(caller, DeviceCaller) else "reviewer"


def _require_same(known: MealEvent, meal: Meal, caller: Caller, event: NewEvent) -> None:
    """Raise ConflictError unless the event that is there is the one that was sent, of the same author."""
    author = caller.device_id if isinstance(caller, DeviceCaller) else caller.staff_id
    is_same = (
        known.meal_id == meal.id
        and known.request_sha256 == event.sha256
        and author in (known.device_id, known.staff_id)
    )
    if not is_same:
        raise ConflictError("An event of this id is there already: a new event needs a new id.", code="event_id_reused")
