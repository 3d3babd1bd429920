"""Whether the ledger of erasures is the one of this database: it has all erasures that the database remembers.

Each was written there first, so one that is missing tells of another ledger, an empty one (the setting points
elsewhere, as after a move to S3) or one that was brought back by a restore. Then who was erased after a backup comes
back with it, and nothing else would tell.
"""

from app.db.session import Database
from app.people import privacy_queries as privacy
from app.privacy.erasure_ledger import KINDS, ErasureLedger


def count_missing(database: Database, ledger: ErasureLedger) -> int:
    """How many erasures have a tombstone in the database and no entry in the ledger. Raises OSError."""
    missing = 0
    for kind in KINDS:
        with database.read() as session:  # before the ledger: what is erased meanwhile stands there first
            remembered = set(privacy.tombstone_digests(session, kind))
        if remembered:
            remembered.difference_update(ledger.digests(kind))
        missing += len(remembered)
    return missing
