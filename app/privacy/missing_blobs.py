"""Which blobs that the database names are not in the store: by listing the store once, not by asking key for key.

A listing tells a thousand keys a call. Of each key eight bytes of a hash are kept, so that twenty million photographs
take 160 MB; at that number a missing one is hidden by another's hash once in a million million times.
What the listing did not have is asked for by itself, since it may have come meanwhile.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import blake2b
from itertools import islice

import numpy as np

from app.storage.blob_store import BlobStore

BATCH = 10_000
LOOKED_AT = 1000  # keys asked for one by one; more that are missing are counted as the listing has it


@dataclass(frozen=True, slots=True)
class MissingBlobs:
    """total: keys that were looked for. first: the first missing ones."""

    total: int
    missing: int
    first: tuple[str, ...]


def find_missing(keys: Iterable[str], blobs: BlobStore) -> MissingBlobs:
    """Compare keys with the store. Raises OSError if the store does not answer."""
    there = np.sort(np.fromiter((_short(blob.key) for blob in blobs.keys()), np.uint64))  # noqa: SIM118  # no mapping
    named, total, missing = iter(keys), 0, 0
    first: list[str] = []
    while batch := list(islice(named, BATCH)):
        total += len(batch)
        short = np.fromiter(map(_short, batch), np.uint64, len(batch))
        at = np.searchsorted(there, short)
        is_there = (at < len(there)) & (there[np.minimum(at, len(there) - 1)] == short) if len(there) else at < 0
        for key in (key for key, found in zip(batch, is_there, strict=True) if not found):
            if missing < LOOKED_AT and blobs.has(key):
                continue
            missing += 1
            if missing <= LOOKED_AT:
                first.append(key)
    return MissingBlobs(total, missing, tuple(first))


def _short(key: str) -> int:
    return int.from_bytes(blake2b(key.encode(), digest_size=8).digest(), "little")
