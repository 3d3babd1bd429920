"""Enter a meal without photographs: the participant states foods and amounts, and each becomes an item by an event.

The meal is confirmed at once, unless an amount is missing. As with photographs, the same id again
is the same meal, and an erased meal cannot be sent again.
"""

import uuid
from collections.abc import Sequence

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.session import Database
from app.meals.stored import queries as meals
from app.meals.stored.item_state import COPIED, fold_meal
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item
from app.meals.upload.meal_draft import MealDraft, draft_declared, require_same
from app.meals.upload.schemas import DeclaredItemIn, DeclaredMealIn
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


class DeclareMeal:
    """The use case; one per process."""

    def __init__(self, database: Database, box: SecretBox) -> None:
        self._database = database
        self._box = box

    def declare(self, caller: DeviceCaller, declared: DeclaredMealIn) -> bool:
        """Keep the meal. Returns False if it exists.

        Raises InvalidInputError (a food, the time), ConflictError, GoneError.
        """
        draft = draft_declared(declared)
        try:
            return self._write(caller, draft, declared.items)
        except IntegrityError:  # an identical request was committed first
            return self._write(caller, draft, declared.items)

    def _write(
        self, caller: DeviceCaller, draft: MealDraft, items: Sequence[DeclaredItemIn]
    ) -> bool:
        meal_id = meal_id_of(caller.participant_id, draft.client_id)
        with self._database.write() as session:
            require_in_study(session, caller.participant_id)
            meal = meals.lock_meal(session, meal_id)
            if meal is not None:
                require_same(draft, meal)
                return False
            require_not_deleted(session, self._box, meal_id)
            study = session.get_one(Study, caller.study_id)
            location = policy_of(study).apply(draft.details["location"])
            meal = draft.row(caller, study, meal_id, location)
            session.add(meal)
            session.flush()
            _add_items(session, caller, meal, items)
            app_version = draft.details["app_version"]
            if app_version is not None:
                people.note_app_version(session, caller.device_id, app_version)
            project_meal(session, meal)
            audit.note(session, caller, "meal.declare", subject=meal.alias, items=len(items))
        return True


def _add_items(
    session: Session, caller: DeviceCaller, meal: Meal, items: Sequence[DeclaredItemIn]
) -> None:
    parts = MealParts(meal)
    for number, item in enumerate(items, start=1):
        event_id = uuid.uuid5(meal.id, f"declared/{number}")
        event = AddIn(id=event_id, kind="add", food=item.food, amount=item.amount, share=item.share)
        context = ReviewContext(
            session, meal, parts, fold_meal(parts), event_id, "participant", meal.received_at
        )
        change = add(context, event, "declared", DECLARED_SD)
        insert_event(session, caller, meal, event, change, sequence=number, now=meal.received_at)
        entered: Item = change.rows[0]  # type: ignore[assignment]  # the item goes first
        entered.flags = [COPIED] if item.copied else []
        parts.items.append(entered)
