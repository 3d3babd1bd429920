"""Announce deleted meals and withdrawn participants to a study's webhooks."""

import hashlib

from sqlalchemy.orm import Session

from app.meals.stored.models import Meal
from app.outbox.write import announce
from app.people.models import Participant, WithdrawalPolicy


def announce_meal_deletion(session: Session, meal: Meal) -> None:
    """Announce that a meal is about to be erased. Its id is sent as SHA-256, which only holders of the id recognise."""
    participant = session.get_one(Participant, meal.participant_id)
    digest = hashlib.sha256(str(meal.client_id).encode()).hexdigest()
    announce(
        session,
        meal.study_id,
        "meal.deleted",
        {"participant": participant.code, "meal_sha256": digest},
        participant_id=participant.id,
    )


def announce_withdrawal(
    session: Session, participant: Participant, policy: WithdrawalPolicy
) -> None:
    """Announce that a participant leaves the study.

    The delivery outlives the participant's rows, so it does not refer to them; its payload is removed once it is
    delivered (webhooks/deliver_webhooks.py).
    """
    announce(
        session,
        participant.study_id,
        "participant.withdrawn",
        {"participant": participant.code, "policy": policy},
    )
