"""What services announce to a study's webhooks, each in the transaction of the event; write.py writes it down.

A payload holds ids, a status, a version, a day, codes. Never a photograph, food, figure, place or free text: whoever is
told asks the API for the rest, under their own role and noted in the audit log.
"""

import hashlib

from sqlalchemy.orm import Session

from app.diary.models import DiaryDay
from app.meals.models import Meal
from app.outbox.models import Event
from app.outbox.write import announce, announce_meal
from app.people.models import Participant

__all__ = ["announce", "announce_day", "announce_meal", "meal_deleted", "participant_withdrawn"]


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


def announce_day(session: Session, participant: Participant, day: DiaryDay) -> None:
    """Something was said about a participant's day: it is closed now, or open again."""
    data = {"participant": participant.code, "local_date": day.local_date.isoformat(), "ate_nothing": day.ate_nothing}
    event: Event = "day.closed" if day.status == "closed" else "day.reopened"
    announce(session, participant.study_id, event, data, participant_id=participant.id)
