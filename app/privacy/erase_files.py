"""Apply an erasure to files made from a study's rows: exports expire, releases lose the erased rows.

Call it at the end of the erasure's transaction, after its receipt (exports/queries.py explains why).
"""

import uuid

from sqlalchemy.orm import Session

from app.exports import queries as exports
from app.exports.releases import queries as releases
from app.exports.releases.digests import meal_digest, participant_digest
from app.people.access.secret_box import SecretBox


def erase_meal_from_files(
    session: Session,
    box: SecretBox,
    study_id: uuid.UUID,
    participant_code: str,
    client_id: uuid.UUID,
) -> None:
    """Erase a meal, which files identify by its participant's code and the phone's id."""
    exports.erase_from_exports(session, study_id, None)
    releases.erase_from_releases(
        session, study_id, "meal", meal_digest(box, participant_code, client_id)
    )


def erase_person_from_files(
    session: Session,
    box: SecretBox,
    study_id: uuid.UUID,
    participant_code: str,
    renamed: tuple[str, uuid.UUID] | None,
) -> None:
    """Erase or anonymise a participant, whom files identify by code. renamed: new code and seed of new meal ids."""
    exports.erase_from_exports(session, study_id, participant_code)
    deed: releases.Deed = "erase" if renamed is None else "anonymise"
    releases.erase_from_releases(
        session, study_id, deed, participant_digest(box, participant_code), renamed
    )
