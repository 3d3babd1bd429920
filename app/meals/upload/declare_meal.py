"""Enter a meal without photographs: the participant states foods and amounts, and each becomes an item by an event.

The meal is confirmed at once, unless an amount is missing. As with photographs, the same id again
is the same meal, and an erased meal cannot be sent again.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import cast

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError
from app.db.session import Database
from app.meals.stored import queries as meals
from app.meals.stored.item_state import fold_meal
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.meal_time import MealTime
from app.meals.stored.models import DeclaredItemDetails, Meal, MealDetails
from app.meals.upload.schemas import DeclaredItemIn
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import meal_id_of, require_not_deleted
from app.records.project_records import project_meal
from app.records.review.meal_events import insert_event
from app.records.review.review_context import DECLARED_SD, ReviewContext
from app.records.review.review_meal import add
from app.records.review.schemas import AddIn


@dataclass(frozen=True, slots=True)
class DeclaredMeal:
    """The checked request."""

    client_id: uuid.UUID
    time: MealTime
    items: tuple[DeclaredItemIn, ...]
    location: Mapping[str, float] | None = None
    app_version: str | None = None


class DeclareMeal:
    """The use case; one per process."""

    def __init__(self, database: Database, box: SecretBox) -> None:
        self._database = database
        self._box = box

    def declare(self, caller: DeviceCaller, declared: DeclaredMeal) -> bool:
        """Keep the meal. Returns False if it exists. Raises InvalidInputError (a food), ConflictError, GoneError."""
        try:
            return self._declare(caller, declared)
        except (
            IntegrityError
        ):  # an identical request was written at the same time and committed first
            return self._declare(caller, declared)

    def _declare(self, caller: DeviceCaller, declared: DeclaredMeal) -> bool:
        meal_id = meal_id_of(caller.participant_id, declared.client_id)
        with self._database.write() as session:
            require_in_study(session, caller.participant_id)
            meal = meals.lock_meal(session, meal_id)
            if meal is not None:
                _require_same(meal, declared)
                return False
            require_not_deleted(session, self._box, meal_id)
            meal = _new_meal(session.get_one(Study, caller.study_id), caller, meal_id, declared)
            session.add(meal)
            session.flush()
            _add_items(session, caller, meal, declared)
            if declared.app_version is not None:
                people.note_app_version(session, caller.device_id, declared.app_version)
            project_meal(session, meal)
            audit.note(
                session, caller, "meal.declare", subject=meal.alias, items=len(declared.items)
            )
        return True


def _require_same(meal: Meal, declared: DeclaredMeal) -> None:
    stored: Mapping[str, object] = meal.details
    sent = _details(declared, None).items()
    if meal.origin != "declared" or any(
        stored.get(name) != value for name, value in sent if name != "location"
    ):
        raise ConflictError(
            "A meal with this id is already here with other content. Use a new id for a new meal.",
            code="meal_id_reused",
        )


def _add_items(session: Session, caller: DeviceCaller, meal: Meal, declared: DeclaredMeal) -> None:
    parts = MealParts(meal)
    for number, item in enumerate(declared.items, start=1):
        event_id = uuid.uuid5(meal.id, f"declared/{number}")
        event = AddIn(id=event_id, kind="add", food=item.food, amount=item.amount, share=item.share)
        context = ReviewContext(
            session, meal, parts, fold_meal(parts), event_id, "participant", meal.received_at
        )
        change = add(context, event, "declared", DECLARED_SD)
        insert_event(session, caller, meal, event, change, sequence=number, now=meal.received_at)
        parts.items.append(change.rows[0])  # type: ignore[arg-type]  # the item goes before what refers to it


def _new_meal(
    study: Study, caller: DeviceCaller, meal_id: uuid.UUID, declared: DeclaredMeal
) -> Meal:
    return Meal(
        id=meal_id,
        client_id=declared.client_id,
        study_id=caller.study_id,
        participant_id=caller.participant_id,
        device_id=caller.device_id,
        origin="declared",
        captured_at=declared.time.captured_at,
        utc_offset_minutes=declared.time.utc_offset_minutes,
        time_zone=declared.time.time_zone,
        local_date=declared.time.local_date(study.day_starts_minutes),
        details=_details(declared, policy_of(study).apply(declared.location)),
        status="receiving",
        version=1,
        received_at=datetime.now(UTC),
    )


def _details(declared: DeclaredMeal, location: dict[str, float] | None) -> MealDetails:
    """Return the details of a meal, with the declared foods."""
    return {
        "captured_at": declared.time.captured_at.isoformat(),
        "time_zone": declared.time.time_zone,
        "marker": None,
        "camera": None,
        "hints": [],
        "location": location,
        "app_version": declared.app_version,
        "declared": [
            cast(DeclaredItemDetails, item.model_dump(mode="json")) for item in declared.items
        ],
    }
