"""The ledger of erasures, which is not part of backups: after a restore, its erasures are carried out again.

Each erasure is one small blob, `kind/digest`, with the digest of the id under the server's secret
key, so that the ledger identifies nobody. It is written before the erasure's transaction; if the
process crashes in between, the next start carries out the erasure (privacy/reapply_erasures.py).
"""

import json
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from app.db.session import Database
from app.people import privacy_queries as privacy
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.models import WithdrawalPolicy
from app.people.tombstones import Kind
from app.storage.blob_store import BlobStore

KINDS: tuple[Kind, ...] = ("participant", "meal")


@dataclass(frozen=True, slots=True)
class Erasure:
    """An erasure, carried out or not. policy: "erase" for a meal."""

    kind: Kind
    policy: WithdrawalPolicy
    digest: str
    receipt_id: uuid.UUID
    at: datetime


class ErasureLedger:
    """The ledger in a blob store of its own."""

    def __init__(self, store: BlobStore, box: SecretBox) -> None:
        self._store = store
        self._key_mark = box.digest("ledger", "key")

    def write(self, erasure: Erasure) -> None:
        """Write an erasure durably. Writing it again is harmless."""
        entry = {
            "deed": erasure.policy,
            "receipt": str(erasure.receipt_id),
            "at": erasure.at.isoformat(),
            "key": self._key_mark,
        }
        self._store.put_bytes(f"{erasure.kind}/{erasure.digest}", json.dumps(entry).encode())

    def digests(self, kind: Kind, before: datetime | None = None) -> Iterator[str]:
        """Yield the digests of all erasures of this kind, or of those written before a time."""
        for blob in self._store.keys(f"{kind}/"):
            if before is None or blob.stored_at < before:
                yield blob.key.removeprefix(f"{kind}/")

    def read(self, kind: Kind, digest: str) -> Erasure:
        """Read an erasure.

        Raises BlobMissingError, SecretKeyError if it was written under another key.
        """
        entry = json.loads(self._store.read(f"{kind}/{digest}"))
        if entry["key"] != self._key_mark:
            raise SecretKeyError(
                "The ledger of erasures has entries that this database lacks, made under another TADA_SECRET_KEY: "
                "set that key, or people who were erased would come back from a backup."
            )
        return Erasure(
            kind=kind,
            policy=entry["deed"],
            digest=digest,
            receipt_id=uuid.UUID(entry["receipt"]),
            at=datetime.fromisoformat(entry["at"]),
        )


def count_missing(database: Database, ledger: ErasureLedger) -> int:
    """Count the erasures that have a tombstone in the database but no entry in the ledger.

    Each erasure is written to the ledger first. If one is missing, the ledger is another one, is
    empty (the setting points elsewhere, for example after a move to S3) or was itself restored.
    Then people erased after a backup would come back with it, and nothing else would show that.
    Raises OSError.
    """
    missing = 0
    for kind in KINDS:
        # before the ledger, to which concurrent erasures are written first
        with database.read() as session:
            digests = set(privacy.tombstone_digests(session, kind))
        if digests:
            digests.difference_update(ledger.digests(kind))
        missing += len(digests)
    return missing
