"""Erased participants and meals, remembered by digests that identify nobody."""

import uuid
from typing import Literal

from sqlalchemy.orm import Session

from app.core.errors import GoneError
from app.people import queries as people
from app.people.access.secret_box import SecretBox
from app.people.models import WithdrawalPolicy

Kind = Literal["participant", "meal"]
MEAL_NAMESPACE = uuid.UUID(
    "6f0d3d0a-6c0c-4e0e-9a53-52f9b4a4d7f1"
)  # drawn once; internal ids of meals derive from it


def digest_of(box: SecretBox, kind: Kind, policy: WithdrawalPolicy, subject_id: uuid.UUID) -> str:
    """Return the digest of a participant or a meal in the ledger and in tombstones.

    Each policy gives another digest: a participant whose data were kept may be erased later, and the ledger has both.
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
