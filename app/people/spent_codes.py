"""A participant's code is given once in a study: what was pulled under it would otherwise be of two persons.

While the row stays, its code is taken. Once it is erased or anonymised, what remains of the code is a digest that only
this server's secret key makes, so that it names nobody and can still be refused to the next one.
"""

import uuid
from datetime import datetime

from sqlalchemy.orm import Session

from app.people.access.secret_box import SecretBox
from app.people.models import Participant
from app.people.privacy_models import SpentCode


def spend_code(session: Session, box: SecretBox, participant: Participant, now: datetime) -> None:
    """Before the participant's row loses its code."""
    digest = _digest(box, participant.code)
    if session.get(SpentCode, (participant.study_id, digest)) is None:
        session.add(SpentCode(study_id=participant.study_id, digest=digest, spent_at=now))
        session.flush()


def is_code_spent(session: Session, box: SecretBox, study_id: uuid.UUID, code: str) -> bool:
    """Whether somebody had the code who was erased or anonymised since."""
    return session.get(SpentCode, (study_id, _digest(box, code))) is not None


def _digest(box: SecretBox, code: str) -> str:
    return box.digest("participant.code", code)
