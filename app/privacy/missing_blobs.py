"""Find blobs that the database names but the store lacks. Apart from what the server imports: it loads no NumPy."""

from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import blake2b
from itertools import islice

import numpy as np

from app.storage.blob_store import BlobStore

KEYS_COMPARED_AT_ONCE = 10_000
MAX_LOOKUPS = 1000  # keys looked up one by one; for further ones the listing decides


@dataclass(frozen=True, slots=True)
class MissingBlobs:
    """The result. total: keys compared; first: the first missing keys."""

    total: int
    missing: int
    first: tuple[str, ...]


def find_missing(keys: Iterable[str], blobs: BlobStore) -> MissingBlobs:
    """Return the keys that the database names and the store lacks, by listing the store once.

    Eight bytes of a hash are kept per key, so twenty million photographs take 160 MB; at that
    number, another key's hash hides a missing blob once in 10^12 cases. Keys that are not in the
    listing are looked up one by one, since they may have been stored meanwhile. Raises OSError if
    the store does not answer.
    """
    stored = np.sort(np.fromiter((_short_hash(blob.key) for blob in blobs.keys()), np.uint64))  # noqa: SIM118  # no mapping
    named, total, missing = iter(keys), 0, 0
    first: list[str] = []
    while batch := list(islice(named, KEYS_COMPARED_AT_ONCE)):
        total += len(batch)
        hashes = np.fromiter(map(_short_hash, batch), np.uint64, len(batch))
        at = np.searchsorted(stored, hashes)
        is_stored = (
            (at < len(stored)) & (stored[np.minimum(at, len(stored) - 1)] == hashes)
            if len(stored)
            else at < 0
        )
        for key in (key for key, is_listed in zip(batch, is_stored, strict=True) if not is_listed):
            if missing < MAX_LOOKUPS and blobs.has(key):
                continue
            missing += 1
            if missing <= MAX_LOOKUPS:
                first.append(key)
    return MissingBlobs(total, missing, tuple(first))


def _short_hash(key: str) -> int:
    return int.from_bytes(blake2b(key.encode(), digest_size=8).digest(), "little")
