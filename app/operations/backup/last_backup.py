"""Record a backup in the audit log, since it reads all data; `tada doctor` and /metrics read it there.

Backups made by other means (PostgreSQL's own, snapshots) must be monitored by other means.
"""

from app.db.session import Database
from app.people.access import audit
from app.people.privacy_models import BACKUP_MADE


def note_backup(database: Database, *, blobs: int, damaged: int, piped: bool = False) -> None:
    """Record a complete backup. damaged: number of blobs that it lacks.

    piped: it was sent to another program, which may not have stored it.
    """
    with database.write() as session:
        audit.note(session, None, BACKUP_MADE, blobs=blobs, damaged=damaged, piped=piped)
