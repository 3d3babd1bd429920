"""When the last backup ended well: noted in the audit log, since all data were read, and asked for by monitoring.

Backups made by other means (PostgreSQL's own, snapshots) are watched by other means.
"""

from datetime import datetime

from sqlalchemy.orm import Session

from app.db.queries.figures import last_event_of_no_study
from app.db.session import Database
from app.services import audit

BACKUP_MADE = "backup.make"


def note_backup(database: Database, *, blobs: int, damaged: int) -> None:
    """A backup is whole and on disk. damaged: blobs that are missing in it."""
    with database.write() as session:
        audit.note(session, None, BACKUP_MADE, blobs=blobs, damaged=damaged)


def last_backup_at(session: Session) -> datetime | None:
    """None: there was none, or it was long ago."""
    return last_event_of_no_study(session, BACKUP_MADE)
