"""An occasion without photographs: foods and amounts as the participant tells them, each an item by a word of its own.

The meal is confirmed as soon as it is in, unless an amount is left open. The same id again is the same meal, as with
photographs; and one that was erased does not come back.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError
from app.db.session import Database
from app.meals import queries as meals
from app.meals.item_state import fold_meal
from app.meals.meal_parts import MealParts
from app.meals.meal_time import MealTime
from app.meals.models import Meal
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import is_meal_deleted, meal_deleted, meal_id_of
from app.records.project_records import project_meal
from app.records.review.meal_events import insert_event
from app.records.review.review_context import ReviewContext
from app.records.review.review_meal import add
from app.records.review.schemas import AddIn
from app.records.review.stated_amounts import DECLARED_SD
from app.uploads.declared_schemas import DeclaredItemIn


@dataclass(frozen=True, slots=True)
class DeclaredMeal:
    """What the phone tells, checked."""

    client_id: uuid.UUID
    time: MealTime
    items: tuple[DeclaredItemIn, ...]
    location: Mapping[str, float] | None = None
    app_version: str | None = None


class DeclareMeal:
    """The use case; one a process."""

    def __init__(self, database: Database, box: SecretBox) -> None:
        self._database = database
        self._box = box

    def declare(self, caller: DeviceCaller, told: DeclaredMeal) -> bool:
        """Keep the meal; False: it is here already. Raises InvalidInputError (a food), ConflictError, GoneError."""
        try:
            return self._declare(caller, told)
        except IntegrityError:  # the same meal came twice at the same time and the other was first
            return self._declare(caller, told)

    def _declare(self, caller: DeviceCaller, told: DeclaredMeal) -> bool:
        meal_id = meal_id_of(caller.participant_id, told.client_id)
        with self._database.write() as session:
            require_in_study(session, caller.participant_id)
            meal = meals.lock_meal(session, meal_id)
            if meal is not None:
                _require_same(meal, told)
                return False
            if is_meal_deleted(session, self._box, meal_id):
                raise meal_deleted()
            meal = _new_meal(session.get_one(Study, caller.study_id), caller, meal_id, told)
            session.add(meal)
            session.flush()
            _add_items(session, caller, meal, told)
            if told.app_version is not None:
                people.note_app_version(session, caller.device_id, told.app_version)
            project_meal(session, meal)
            audit.note(session, caller, "meal.declare", subject=meal.alias, items=len(told.items))
        return True


def _require_same(meal: Meal, told: DeclaredMeal) -> None:
    here, new = meal.details, _details(told, None)
    if meal.origin != "declared" or any(here.get(name) != new[name] for name in new if name != "location"):
        raise ConflictError(
            "A meal with this id is already here and says something else. Use a new id for a new meal.",
            code="meal_id_reused",
        )


def _add_items(session: Session, caller: DeviceCaller, meal: Meal, told: DeclaredMeal) -> None:
    parts = MealParts(meal)
    for number, item in enumerate(told.items, start=1):
        event_id = uuid.uuid5(meal.id, f"declared/{number}")
        event = AddIn(id=event_id, kind="add", food=item.food, amount=item.amount, share=item.share)
        context = ReviewContext(session, meal, parts, fold_meal(parts), event_id, "participant", meal.received_at)
        change = add(context, event, "declared", DECLARED_SD)
        insert_event(session, caller, meal, event, change, sequence=number, now=meal.received_at)
        parts.items.append(change.rows[0])  # type: ignore[arg-type]  # the item goes before what refers to it


def _new_meal(study: Study, caller: DeviceCaller, meal_id: uuid.UUID, told: DeclaredMeal) -> Meal:
    return Meal(
        id=meal_id,
        client_id=told.client_id,
        study_id=caller.study_id,
        participant_id=caller.participant_id,
        device_id=caller.device_id,
        origin="declared",
        captured_at=told.time.captured_at,
        utc_offset_minutes=told.time.utc_offset_minutes,
        time_zone=told.time.time_zone,
        local_date=told.time.local_date(study.day_starts_minutes),
        details=_details(told, policy_of(study).kept(told.location)),
        status="receiving",
        version=1,
        received_at=datetime.now(UTC),
    )


def _details(told: DeclaredMeal, location: Mapping[str, float] | None) -> dict[str, Any]:
    """As those of a meal with photographs, and what was told of its foods."""
    return {
        "captured_at": told.time.captured_at.isoformat(),
        "time_zone": told.time.time_zone,
        "marker": None,
        "camera": None,
        "hints": [],
        "location": location,
        "app_version": told.app_version,
        "declared": [item.model_dump(mode="json") for item in told.items],
    }
