"""The digests by which erased rows are found in releases; a module of its own, without DuckDB."""

import uuid

from app.people.access.secret_box import SecretBox


def meal_digest(box: SecretBox, participant_code: str, meal_id: uuid.UUID | str) -> str:
    """Return the digest by which a meal's rows are recognised in a release."""
    return box.digest("release.meal", f"{participant_code}\n{meal_id}")


def participant_digest(box: SecretBox, participant_code: str) -> str:
    """Return the digest by which a participant's rows are recognised in a release."""
    return box.digest("release.participant", participant_code)
