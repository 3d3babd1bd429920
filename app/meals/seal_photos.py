"""Received photographs into the blob store, before any row names them; a photograph's row; what a full disk answers."""

import errno
import uuid
from collections.abc import Collection, Mapping
from datetime import datetime

from sqlalchemy.orm import Session

from app.core.errors import StorageFullError, UnavailableError
from app.db import spent_keys
from app.meals.models import MealImage
from app.meals.receive_photo import SealablePhoto
from app.storage.blob_store import BlobStore

RETRY_AFTER_SECONDS = 60
SPENT_RETRY_SECONDS = 1


def seal_photos(
    blobs: BlobStore, photos: Mapping[str, SealablePhoto], keys: Mapping[str, str], stored: Collection[str]
) -> None:
    """Seal those that are not stored yet; photos and keys by slot. Raises StorageFullError."""
    try:
        blobs.put_files({keys[slot]: photo.path for slot, photo in photos.items() if slot not in stored})
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise storage_full() from error
        raise


def unspent_keys(session: Session, keys: Mapping[str, str]) -> dict[str, str]:
    """The keys to seal under, by slot: those given, but another for one that an orphan of the same bytes had."""
    spent = spent_keys.spent_among(session, keys.values())
    return {slot: _another(key) if key in spent else key for slot, key in keys.items()}


def require_unspent(session: Session, keys: Collection[str]) -> None:
    """In the transaction that names them: raise UnavailableError if one was taken for an orphan since it was sealed."""
    spent_keys.hold(session, keys)
    if spent_keys.spent_among(session, keys):
        raise UnavailableError(
            "A photograph of an earlier try was just being removed. Nothing was kept; send it again.",
            retry_after_seconds=SPENT_RETRY_SECONDS,
        )


def image_row(meal_id: uuid.UUID, slot: str, photo: SealablePhoto, key: str, now: datetime) -> MealImage:
    """A sealed photograph as a row."""
    return MealImage(
        id=uuid.uuid4(),
        meal_id=meal_id,
        slot=slot,
        media_type=photo.media_type,
        width_px=photo.width_px,
        height_px=photo.height_px,
        bytes=photo.bytes,
        received_sha256=photo.received_sha256,
        stored_sha256=photo.stored_sha256,
        blob_key=key,
        received_at=now,
    )


def storage_full() -> StorageFullError:
    """Nothing was kept."""
    return StorageFullError(
        "The server's disk is nearly full. Nothing was kept: keep the meal on the phone and try again later.",
        retry_after_seconds=RETRY_AFTER_SECONDS,
    )


def _another(key: str) -> str:
    folder, _, sha256 = key.rpartition("/")
    return f"{folder}/{uuid.uuid4().hex}/{sha256}"
