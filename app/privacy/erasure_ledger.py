"""The ledger of erasures, kept out of backups: after a restore, what was erased is found by it and erased again.

One small blob an erasure, `kind/digest`: the digest of the id under the server's secret key, so that the ledger names
nobody. It is written before the erasure's transaction: from then on the erasure happens, if need be at the next start
(privacy/reapply_erasures.py), so a crash in between loses nothing.
"""

import json
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.tombstones import Deed, Kind
from app.storage.blob_store import BlobStore

KINDS: tuple[Kind, ...] = ("participant", "meal")
DEEDS: tuple[Deed, ...] = ("keep", "anonymise", "erase")  # each does all that the one before it does


@dataclass(frozen=True, slots=True)
class Erasure:
    """An erasure that is to happen, or has happened. deed of a meal: always "erase"."""

    kind: Kind
    deed: Deed
    digest: str
    receipt_id: uuid.UUID
    at: datetime


class ErasureLedger:
    """The ledger over a store of its own."""

    def __init__(self, store: BlobStore, box: SecretBox) -> None:
        self._store = store
        self._key_mark = box.digest("ledger", "key")

    def write(self, erasure: Erasure) -> None:
        """Note it, durably. The same again is harmless."""
        entry = {
            "deed": erasure.deed,
            "receipt": str(erasure.receipt_id),
            "at": erasure.at.isoformat(),
            "key": self._key_mark,
        }
        self._store.put_bytes(f"{erasure.kind}/{erasure.digest}", json.dumps(entry).encode())

    def digests(self, kind: Kind, before: datetime | None = None) -> Iterator[str]:
        """The digests of all noted erasures of this kind, or of those noted before a time."""
        for blob in self._store.keys(f"{kind}/"):
            if before is None or blob.stored_at < before:
                yield blob.key.removeprefix(f"{kind}/")

    def read(self, kind: Kind, digest: str) -> Erasure:
        """One noted erasure. Raises BlobMissingError, SecretKeyError where another key made its digest."""
        entry = json.loads(self._store.read(f"{kind}/{digest}"))
        if entry["key"] != self._key_mark:
            raise SecretKeyError(
                "The ledger of erasures has entries that this database lacks, made under another TADA_SECRET_KEY: "
                "give the key of then, or people who were erased would come back from a backup."
            )
        return Erasure(
            kind=kind,
            deed=entry["deed"],
            digest=digest,
            receipt_id=uuid.UUID(entry["receipt"]),
            at=datetime.fromisoformat(entry["at"]),
        )
