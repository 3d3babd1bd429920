"""A meal that a caller names, locked for a change of it: the one order in which its person and it are locked."""

import uuid
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.core.errors import NotFoundError
from app.meals import queries as meals
from app.meals.models import Meal
from app.people import privacy_queries as privacy
from app.people.access.caller import Caller, DeviceCaller
from app.people.participants import require_in_study
from app.records.read_meal import find_meal


@dataclass(frozen=True, slots=True)
class LockedMeal:
    """Held until the transaction ends."""

    meal: Meal
    participant_code: str
    study_code: str


def lock_meal_of(
    session: Session, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> LockedMeal:
    """The person before the meal, as a withdrawal locks them.

    Raises NotFoundError, NotAllowedError, GoneError (`withdrawn`: the phone's participant left meanwhile).
    """
    if isinstance(caller, DeviceCaller):
        require_in_study(session, caller.participant_id)
    meal, participant, study = find_meal(session, caller, client_id, participant_code)
    locked = lock_with_person(session, meal)
    if locked is None or locked.client_id != client_id:  # erased or anonymised while this waited for it
        raise NotFoundError("There is no such meal.")
    return LockedMeal(locked, participant, study)


def lock_with_person(session: Session, meal: Meal) -> Meal | None:
    """The meal, locked, its person kept from leaving meanwhile; None: erased while this waited for them."""
    privacy.join_participant(session, meal.participant_id)
    return meals.lock_meal(session, meal.id)
