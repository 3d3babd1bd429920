"""The last backup is noted in the audit log, since all data were read; `tada doctor` and /metrics ask for it there.

Backups made by other means (PostgreSQL's own, snapshots) are watched by other means.
"""

from app.db.session import Database
from app.people.access import audit
from app.people.privacy_models import BACKUP_MADE


def note_backup(database: Database, *, blobs: int, damaged: int, piped: bool = False) -> None:
    """A backup is whole and on disk. damaged: blobs that it lacks.

    piped: it was read to its end by another program, and nobody here knows whether that kept it.
    """
    with database.write() as session:
        audit.note(session, None, BACKUP_MADE, blobs=blobs, damaged=damaged, piped=piped)
