"""What is remembered of erased participants and meals: digests that identify nobody.

A spent code cannot be used again in its study: data that were pulled under it could belong to two
persons.
"""

import hashlib
import uuid
from datetime import datetime
from typing import Literal

from sqlalchemy.orm import Session

from app.core.errors import GoneError
from app.people import queries as people
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, WithdrawalPolicy
from app.people.privacy_models import SpentCode

Kind = Literal["participant", "meal"]
# drawn once; internal ids of meals derive from it
MEAL_NAMESPACE = uuid.UUID("6f0d3d0a-6c0c-4e0e-9a53-52f9b4a4d7f1")


def public_digest(public_id: uuid.UUID | str) -> str:
    """Return the SHA-256 of an item's or a day's id as text, which only those who pulled the id can compute."""
    return hashlib.sha256(str(public_id).encode()).hexdigest()


def digest_of(box: SecretBox, kind: Kind, policy: WithdrawalPolicy, subject_id: uuid.UUID) -> str:
    """Return the digest of a participant or a meal in the ledger and in tombstones.

    Each policy gives another digest: a participant whose data were kept may be erased later, and
    the ledger has both.
    """
    return box.digest(kind if kind == "meal" else f"{kind}.{policy}", str(subject_id))


def require_not_deleted(session: Session, box: SecretBox, meal_id: uuid.UUID) -> None:
    """Raise GoneError (`meal_deleted`, with the erasure's `receipt`) if the meal with this internal id was deleted."""
    tombstone = people.find_tombstone(session, "meal", digest_of(box, "meal", "erase", meal_id))
    if tombstone is not None:
        receipt = people.receipt_of_erasure(session, tombstone, "meal")
        facts = {"receipt": str(receipt)} if receipt is not None else {}
        raise GoneError(
            "This meal was deleted; it cannot be sent again.", code="meal_deleted", **facts
        )


def meal_id_of(participant_id: uuid.UUID, client_id: uuid.UUID) -> uuid.UUID:
    """Derive a meal's internal id from the participant's id and the phone's, so that repeated uploads share a row."""
    return uuid.uuid5(MEAL_NAMESPACE, f"{participant_id}/{client_id}")


def spend_code(session: Session, box: SecretBox, participant: Participant, now: datetime) -> None:
    """Store the digest of a participant's code; call it before the row loses the code."""
    digest = _code_digest(box, participant.code)
    if session.get(SpentCode, (participant.study_id, digest)) is None:
        session.add(SpentCode(study_id=participant.study_id, digest=digest, spent_at=now))
        session.flush()


def is_code_spent(session: Session, box: SecretBox, study_id: uuid.UUID, code: str) -> bool:
    """Whether the code belonged to a participant who was erased or anonymised."""
    return session.get(SpentCode, (study_id, _code_digest(box, code))) is not None


def _code_digest(box: SecretBox, code: str) -> str:
    return box.digest("participant.code", code)
