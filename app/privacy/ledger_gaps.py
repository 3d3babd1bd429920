"""Check that the ledger of erasures belongs to the database: it must contain all erasures that the database has.

Each erasure is written to the ledger first. If one is missing, the ledger is another one, is empty (the setting points
elsewhere, for example after a move to S3) or was itself restored. Then people erased after a backup would come back
with it, and nothing else would show that.
"""

from app.db.session import Database
from app.people import privacy_queries as privacy
from app.privacy.erasure_ledger import KINDS, ErasureLedger


def count_missing(database: Database, ledger: ErasureLedger) -> int:
    """Count the erasures with a tombstone in the database but no entry in the ledger. Raises OSError."""
    missing = 0
    for kind in KINDS:
        with (
            database.read() as session
        ):  # before the ledger, to which concurrent erasures are written first
            digests = set(privacy.tombstone_digests(session, kind))
        if digests:
            digests.difference_update(ledger.digests(kind))
        missing += len(digests)
    return missing
