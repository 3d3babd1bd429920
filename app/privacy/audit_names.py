"""The people and meals behind the audit log's aliases, while they exist, for those who may read it."""

import uuid
from collections.abc import Iterable

from app.db.session import Database
from app.privacy import queries as privacy


def names_of_aliases(database: Database, texts: Iterable[str | None]) -> dict[str, str]:
    """Return alias -> a participant's code, or a meal's participant and local day; other texts are left out."""
    aliases = {alias for text in texts if text and (alias := _id_of(text))}
    with database.read() as session:
        people, meals = (
            privacy.participants_by_alias(session, aliases),
            privacy.meals_by_alias(session, aliases),
        )
    return people | {alias: f"{code}, {local_date}" for alias, (code, local_date) in meals.items()}


def _id_of(text: str) -> uuid.UUID | None:
    try:
        return uuid.UUID(text)
    except ValueError:
        return None
