"""Received photographs into the blob store, before any row names them; a photograph's row; what a full disk answers."""

import errno
import uuid
from collections.abc import Collection, Mapping
from datetime import datetime

from app.db.models import MealImage
from app.errors import StorageFullError
from app.services.receive_photo import SealablePhoto
from app.storage.blob_store import BlobStore

RETRY_AFTER_SECONDS = 60


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
