"""Tell a study's webhooks of an erased meal or of a participant who leaves."""

import hashlib

from sqlalchemy.orm import Session

from app.meals.models import Meal
from app.outbox.write import announce
from app.people.models import Participant


def meal_deleted(session: Session, meal: Meal) -> None:
    """A meal is about to be erased. Its id goes as SHA-256: who has the id finds it, and nobody else learns it."""
    participant = session.get_one(Participant, meal.participant_id)
    digest = hashlib.sha256(str(meal.client_id).encode()).hexdigest()
    announce(
        session,
        meal.study_id,
        "meal.deleted",
        {"participant": participant.code, "meal_sha256": digest},
        participant_id=participant.id,
    )


def participant_withdrawn(session: Session, participant: Participant, policy: str) -> None:
    """A participant leaves the study. The notice outlives their rows; what it says of them goes once it is delivered.

    Call it after older deliveries of this participant are removed. policy: keep, anonymise or erase.
    """
    announce(
        session, participant.study_id, "participant.withdrawn", {"participant": participant.code, "policy": policy}
    )
