"""What was erased and may not come back: people and meals by their digests, which name nobody."""

import uuid
from typing import Literal

from sqlalchemy.orm import Session

from app.core.errors import GoneError
from app.people import privacy_queries as people_privacy
from app.people.access.secret_box import SecretBox

Kind = Literal["participant", "meal"]
Deed = Literal["keep", "anonymise", "erase"]


def digest_of(box: SecretBox, kind: Kind, deed: Deed, thing_id: uuid.UUID) -> str:
    """What ledger and tombstones call a person or a meal; each deed has a digest of its own.

    A person who left and whose data were kept may later be erased: both stand in the ledger.
    """
    return box.digest(kind if kind == "meal" else f"{kind}.{deed}", str(thing_id))


def meal_deleted() -> GoneError:
    """What a phone hears of a meal that it deleted."""
    return GoneError("This meal was deleted; it cannot be sent again.", code="meal_deleted")


def is_meal_deleted(session: Session, box: SecretBox, meal_id: uuid.UUID) -> bool:
    """Whether the meal of this id (uploads/submit_meal.py, meal_id_of) was here and is erased."""
    digest = digest_of(box, "meal", "erase", meal_id)
    return bool(people_privacy.tombstones_among(session, "meal", [digest]))


MEAL_NAMESPACE = uuid.UUID("6f0d3d0a-6c0c-4e0e-9a53-52f9b4a4d7f1")  # drawn once; our ids are derived under it


def meal_id_of(participant_id: uuid.UUID, client_id: uuid.UUID) -> uuid.UUID:
    """Our id of a participant's meal: it follows from theirs, so that the same meal again is the same row."""
    return uuid.uuid5(MEAL_NAMESPACE, f"{participant_id}/{client_id}")
