"""Announce a meal's new status to the study's webhooks.

A payload holds ids, a status, a version, a day and codes; never a photograph, food, amount, place
or free text. The receiver gets those from the API, with its own role and an entry in the audit log.
"""

from collections.abc import Mapping

from sqlalchemy.orm import Session

from app.meals.stored.models import Meal, MealStatus
from app.outbox.models import Event
from app.outbox.write import announce, enabled_webhooks
from app.people.models import Participant

EVENT_OF_STATUS: Mapping[MealStatus, Event] = {
    "queued": "meal.received",
    "estimated": "meal.estimated",
    "needs_review": "meal.needs_review",
    "failed": "meal.failed",
    "confirmed": "meal.confirmed",
}


def announce_meal(session: Session, meal: Meal) -> None:
    """Announce the meal's status, if it has an event."""
    event = EVENT_OF_STATUS.get(meal.status)
    if event is None or not enabled_webhooks(session, meal.study_id):
        return
    data = {
        "participant": session.get_one(Participant, meal.participant_id).code,
        "meal_id": str(meal.client_id),
        "status": meal.status,
        "version": meal.version,
        "local_date": meal.local_date.isoformat(),
        "failure_code": meal.failure_code if meal.status == "failed" else None,
    }
    announce(
        session, meal.study_id, event, data, meal_id=meal.id, participant_id=meal.participant_id
    )
