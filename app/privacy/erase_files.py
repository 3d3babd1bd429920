"""What an erasure does to the files that were made of a study's rows: exports expire, releases lose what is erased.

Called in the erasure's transaction, at its end, after its receipt (exports/queries.py tells why).
"""

import uuid

from sqlalchemy.orm import Session

from app.exports import queries as exports
from app.people.access.secret_box import SecretBox
from app.releases import queries as releases
from app.releases.alter_release import meal_digest, participant_digest


def erase_meal_from_files(
    session: Session, box: SecretBox, study_id: uuid.UUID, participant_code: str, client_id: uuid.UUID
) -> None:
    """A meal, by what stands in files: its participant's code and its id on the phone."""
    exports.erase_from_exports(session, study_id, None)
    releases.erase_from_releases(session, study_id, "meal", meal_digest(box, participant_code, client_id))


def erase_person_from_files(
    session: Session,
    box: SecretBox,
    study_id: uuid.UUID,
    participant_code: str,
    renamed: tuple[str, uuid.UUID] | None,
) -> None:
    """A participant, by the code that stands in files. renamed: the code and the drawing of ids of who stays."""
    exports.erase_from_exports(session, study_id, participant_code)
    deed: releases.Deed = "erase" if renamed is None else "anonymise"
    releases.erase_from_releases(session, study_id, deed, participant_digest(box, participant_code), renamed)
