"""Append events of participants and reviewers to a meal's history: one path for all kinds.

An event is checked against the current meal, stored with its old and new values, noted in the audit
log, and the meal's records are projected again, in one transaction under the meal's lock. What each
kind may change is its rule (review_item.py, review_meal.py); this module checks what holds for all:
who may send it, of which version, and once.
"""

import hashlib
import json
import uuid
from datetime import UTC, datetime
from itertools import groupby
from typing import Literal, assert_never

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import (
    ConflictError,
    InvalidInputError,
    NotAllowedError,
    PreconditionFailedError,
)
from app.db.session import Database
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.event_models import MealEvent
from app.meals.stored.item_state import IMPLAUSIBLE_AMOUNT, fold_meal
from app.meals.stored.job_models import Job
from app.meals.stored.meal_parts import MealParts, parts_of, records_of
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.models import Study
from app.records.double_review.drawn import blind_items_of
from app.records.project_records import project_meal
from app.records.read_meal import MealView, lock_meal_of, meal_view
from app.records.review import review_item, review_meal
from app.records.review.review_context import STATED_SD, Change, ReviewContext
from app.records.review.schemas import (
    AddIn,
    AnswerIn,
    AnyEventIn,
    CommentIn,
    ConfirmIn,
    ConfirmMealIn,
    DeclareIn,
    MergeIn,
    NothingLeftIn,
    QuestionIn,
    RedrawIn,
    RejectIn,
    ReshapeIn,
    SetFoodIn,
    SetLeftoverIn,
    SetMassIn,
    SetShareIn,
    SetVolumeIn,
    SplitIn,
    UndoIn,
    item_of,
)

MAX_EVENTS = 1000  # of a meal; each event reads them all
MAX_ITEMS = 200  # of a meal, including those that were split, merged and undone
# need no estimated meal
BEFORE_ESTIMATE = frozenset({"nothing_left", "undo", "comment", "question", "answer"})
ONLY_LAYER = {
    "question": "reviewer",
    "reshape": "reviewer",
    "answer": "participant",
}  # kinds that only one layer may send


def apply_event(context: ReviewContext, event: AnyEventIn) -> Change:  # noqa: C901, PLR0912  # one case per kind
    """Apply the rule of the event's kind.

    Raises a TadaError if the meal does not allow the event.
    """
    match event:
        case ConfirmIn():
            return review_item.confirm(context, event)
        case RejectIn():
            return review_item.reject(context, event)
        case SetFoodIn():
            return review_item.set_food(context, event)
        case SetVolumeIn():
            return review_item.set_volume(context, event)
        case SetMassIn():
            return review_item.set_mass(context, event)
        case SetShareIn():
            return review_item.set_share(context, event)
        case RedrawIn():
            return review_item.redraw(context, event)
        case ReshapeIn():
            return review_item.reshape(context, event)
        case DeclareIn():
            return review_item.declare(context, event)
        case AddIn():
            return review_meal.add(context, event, "added", STATED_SD)
        case SplitIn():
            return review_meal.split(context, event)
        case MergeIn():
            return review_meal.merge(context, event)
        case SetLeftoverIn():
            return review_meal.set_leftover(context, event)
        case NothingLeftIn():
            return review_meal.nothing_left(context)
        case ConfirmMealIn():
            return review_meal.confirm_meal(context)
        case CommentIn() | QuestionIn():
            return review_meal.write_text(context, event)
        case AnswerIn():
            return review_meal.answer(context, event)
        case UndoIn():
            return review_meal.undo(context, event)
        case _:
            assert_never(event)


class MealEvents:
    """The use case; one per process."""

    def __init__(self, database: Database, queue: JobQueue) -> None:
        self._database = database
        self._queue = queue

    def append(
        self,
        caller: Caller,
        client_id: uuid.UUID,
        event: AnyEventIn,
        *,
        expected: frozenset[int] | None,
        participant_code: str | None = None,
    ) -> tuple[MealView, bool]:
        """Append the event; return the meal and whether the event is new: a repeat changes nothing.

        expected: versions of the meal that the caller may have read; None: any version. Raises
        NotFoundError, NotAllowedError, ConflictError, InvalidInputError, PreconditionFailedError,
        GoneError (`withdrawn`: the phone's participant left meanwhile).
        """
        try:
            return self._append(caller, client_id, event, expected, participant_code)
        except IntegrityError:  # the same id at the same time for another meal, which was first
            return self._append(caller, client_id, event, expected, participant_code)

    def _append(
        self,
        caller: Caller,
        client_id: uuid.UUID,
        event: AnyEventIn,
        expected: frozenset[int] | None,
        participant_code: str | None,
    ) -> tuple[MealView, bool]:
        with self._database.write() as session:
            meal, participant, study = lock_meal_of(session, caller, client_id, participant_code)
            stored = session.get(MealEvent, event.id)
            if stored is not None:
                _require_same(stored, meal, caller, event)
                return meal_view(session, meal, participant, study), False
            if expected is not None and meal.version not in expected:
                raise PreconditionFailedError(
                    "The meal has changed since you read it: GET it again, then send what still applies.",
                    version=meal.version,
                )
            parts = parts_of(session, [meal])[0]  # keeps the rows in the session's identity map
            before = _implausible_items(session, meal) if event.strict else set()
            self.write(session, caller, parts, event)
            project_meal(session, meal)
            if event.strict and _implausible_items(session, meal) - before:
                raise InvalidInputError(
                    "Nobody eats so much of one food, or the photographs show far more or less. Send it without "
                    "`strict` to store it all the same.",
                    code="implausible_amount",
                )
            return meal_view(session, meal, participant, study), True

    def write(self, session: Session, caller: Caller, parts: MealParts, event: AnyEventIn) -> None:
        """Append the event to a locked meal, whose projection is left to the caller. Raises as `append`."""
        meal, layer = parts.meal, layer_of(caller)
        if ONLY_LAYER.get(event.kind, layer) != layer:
            raise NotAllowedError(
                f"A {layer} cannot send this event: {event.kind}.", code="event_not_yours"
            )
        if meal.status in meals.UNESTIMATED and event.kind not in BEFORE_ESTIMATE:
            raise ConflictError(
                "The meal is not estimated yet: wait until it is (GET it with ?wait=).",
                code="meal_not_estimated",
                meal_status=meal.status,
            )
        if layer == "reviewer":
            _require_not_blind(session, meal, event)
        if len(parts.events) >= MAX_EVENTS:
            raise ConflictError(
                f"A meal can have at most {MAX_EVENTS} events.", code="events_too_many"
            )
        now = datetime.now(UTC)
        change = apply_event(
            ReviewContext(session, meal, parts, fold_meal(parts), event.id, layer, now), event
        )
        created = sum(isinstance(row, Item) for row in change.rows)
        if created and len(parts.items) + created > MAX_ITEMS:
            raise ConflictError(
                f"A meal can have at most {MAX_ITEMS} items.", code="items_too_many"
            )
        sequence = 1 + max((earlier.sequence for earlier in parts.events), default=0)
        insert_event(session, caller, meal, event, change, sequence=sequence, now=now)
        for row in change.rows:
            if isinstance(row, Job):
                self._queue.enqueue(session, row)
        audit.note(
            session,
            caller,
            "meal.event",
            study_id=meal.study_id,
            subject=meal.alias,
            kind=event.kind,
        )


def insert_event(
    session: Session,
    caller: Caller,
    meal: Meal,
    event: AnyEventIn,
    change: Change,
    *,
    sequence: int,
    now: datetime,
) -> None:
    """Insert an event and the rows that it creates."""
    session.add(
        MealEvent(
            id=event.id,
            meal_id=meal.id,
            sequence=sequence,
            item_id=item_of(event),
            kind=event.kind,
            layer=layer_of(caller),
            device_id=caller.device_id if isinstance(caller, DeviceCaller) else None,
            staff_id=caller.staff_id if isinstance(caller, StaffCaller) else None,
            old=dict(change.old),
            new=dict(change.new),
            request_sha256=content_sha256(event),
            created_at=now,
        )
    )
    session.flush()
    for _, rows in groupby(change.rows, key=type):  # rows reference those before them
        session.add_all(rows)
        session.flush()


def layer_of(caller: Caller) -> Literal["participant", "reviewer"]:
    """Return the layer that the caller's events belong to."""
    return "participant" if isinstance(caller, DeviceCaller) else "reviewer"


def _require_not_blind(session: Session, meal: Meal, event: AnyEventIn) -> None:
    """Raise ConflictError if the event decides an item that two decide without seeing each other."""
    if isinstance(event, CommentIn | QuestionIn):
        return
    blind = blind_items_of(session, session.get_one(Study, meal.study_id), meal.id)
    items = {item_of(event), *(event.items if isinstance(event, MergeIn) else ())}
    if (isinstance(event, ConfirmMealIn) and blind) or blind & items:
        raise ConflictError(
            "Two reviewers decide this item without seeing each other: decide it there.",
            code="item_blind",
        )


def _implausible_items(session: Session, meal: Meal) -> set[uuid.UUID]:
    return {
        item_id
        for item_id, record in records_of(session, meal.id).items()
        if IMPLAUSIBLE_AMOUNT in record.flags
    }


def _require_same(stored: MealEvent, meal: Meal, caller: Caller, event: AnyEventIn) -> None:
    """Raise ConflictError unless the stored event is the one that was sent, by the same author."""
    author = caller.device_id if isinstance(caller, DeviceCaller) else caller.staff_id
    is_same = (
        stored.meal_id == meal.id
        and stored.request_sha256 == content_sha256(event)
        and author in (stored.device_id, stored.staff_id)
    )
    if not is_same:
        raise ConflictError(
            "An event with this id exists already: a new event needs a new id.",
            code="event_id_reused",
        )


def content_sha256(event: AnyEventIn) -> str:
    """Return the digest of an event's content, without its id.

    It is stored: computed in another way, it would refuse repeats of events that were sent before
    an upgrade.
    """
    item = item_of(event)
    fields: dict[str, object] = event.model_dump(
        mode="json", exclude={"id", "kind", "item", "strict"}
    )
    if isinstance(event, SetMassIn):
        fields = {"amount": event.amount().model_dump(mode="json")}
    elif isinstance(event, SetVolumeIn):
        fields = {"amount": fields}
    content = [event.kind, str(item) if item is not None else None, fields]
    return hashlib.sha256(
        json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()
