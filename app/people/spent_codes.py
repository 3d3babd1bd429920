"""Codes of participants who were erased or anonymised, which a study cannot use again.

Otherwise data that were pulled under a code could belong to two persons. Only a keyed digest of the code is stored, so
that it identifies nobody and the code can still be refused.
"""

import uuid
from datetime import datetime

from sqlalchemy.orm import Session

from app.people.access.secret_box import SecretBox
from app.people.models import Participant
from app.people.privacy_models import SpentCode


def spend_code(session: Session, box: SecretBox, participant: Participant, now: datetime) -> None:
    """Store the digest of a participant's code; call it before the row loses the code."""
    digest = _digest(box, participant.code)
    if session.get(SpentCode, (participant.study_id, digest)) is None:
        session.add(SpentCode(study_id=participant.study_id, digest=digest, spent_at=now))
        session.flush()


def is_code_spent(session: Session, box: SecretBox, study_id: uuid.UUID, code: str) -> bool:
    """Whether the code belonged to a participant who was erased or anonymised."""
    return session.get(SpentCode, (study_id, _digest(box, code))) is not None


def _digest(box: SecretBox, code: str) -> str:
    return box.digest("participant.code", code)
