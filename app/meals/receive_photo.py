"""A received file to a sealed photograph: inspected, without its location, decoded once, in the blob store, a row.

The bytes are walked here, never decoded. A hole between the beginning and the end of a file shows only when the pixels
are decoded, which a child does before the photograph is acknowledged: afterwards the phone deletes its own. Where no
child can tell, the photograph is kept as it is: the estimate will tell.
"""

import errno
import hashlib
import uuid
from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren, Whose
from app.children.decoding_cost import is_costly
from app.core.errors import (
    InvalidInputError,
    TadaError,
    TooLargeError,
    UnavailableError,
    UnsupportedMediaError,
)
from app.db import spent_keys
from app.http.upload import ReceivedFile, storage_full
from app.meals.models import MealImage
from app.people.access.caller import DeviceCaller
from app.people.location_policy import LocationPolicy
from app.photos.gps import Location
from app.photos.inspect import PhotoFacts, inspect_photo
from app.photos.location import read_location, remove_location
from app.storage.blob_store import BlobStore

SIDEWAYS = frozenset({5, 6, 7, 8})  # EXIF orientations that turn by a quarter
DECODING_SECONDS = 10.0  # of processor time; 60 megapixels in 20 scans take some five on a slow machine
JPEG = "image/jpeg"  # other formats have checksums, or a decoder that fails where data lack
SPENT_RETRY_SECONDS = 1


@dataclass(frozen=True, slots=True)
class SealablePhoto:
    """A checked photograph in the staging folder. width_px and height_px are upright.

    location: what its tags said before they were cut, where the study's policy asks for it.
    """

    path: Path
    media_type: str
    width_px: int
    height_px: int
    bytes: int
    received_sha256: str
    stored_sha256: str
    location: Location | None = None


def prepare_photo(slot: str, file: ReceivedFile, *, max_pixels: int, policy: LocationPolicy) -> SealablePhoto:
    """Inspect a received file, cut its location tags by the policy. Raises what the phone should hear, `slot` named."""
    if file.bytes == 0:
        raise InvalidInputError(f"The {slot} photograph is empty: send its bytes.", code="part_empty", slot=slot)
    facts = inspect_photo(file.path)
    if not isinstance(facts, PhotoFacts):
        message = f"The {slot} photograph: {facts.message}" + (f" {facts.advice}" if facts.advice else "")
        if facts.code == "not_an_image":
            raise UnsupportedMediaError(message, code=facts.code, slot=slot)
        raise InvalidInputError(message, code=facts.code, slot=slot)
    if facts.pixels_to_decode > max_pixels:
        raise TooLargeError(
            f"The {slot} photograph has {facts.pixels_to_decode} pixels; at most {max_pixels} are allowed.",
            code="image_too_many_pixels",
            slot=slot,
            limit_pixels=max_pixels,
        )
    location = read_location(file.path, facts) if policy.reads_tags else None
    changed = policy.cuts_tags and remove_location(file.path, facts)
    upright = (facts.height, facts.width) if facts.orientation in SIDEWAYS else (facts.width, facts.height)
    return SealablePhoto(
        path=file.path,
        media_type=facts.media_type,
        width_px=upright[0],
        height_px=upright[1],
        bytes=file.bytes,
        received_sha256=file.sha256,
        stored_sha256=sha256_of_file(file.path) if changed else file.sha256,
        location=location,
    )


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def require_whole(
    children: ApiChildren, caller: DeviceCaller, photos: Mapping[str, SealablePhoto], stored: Container[str]
) -> None:
    """Photographs by slot. stored: slots whose photograph is here already, so that it need not be decoded again.

    Raises InvalidInputError (`image_unreadable`) where a JPEG lacks part of its pixels.
    """
    if not children.are_up:
        return
    for slot, photo in photos.items():
        if photo.media_type == JPEG and slot not in stored:
            _require_whole(children, caller, slot, photo)


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


def _require_whole(children: ApiChildren, caller: DeviceCaller, slot: str, photo: SealablePhoto) -> None:
    try:
        found = children.run(
            "whole",
            {"photo": str(photo.path)},
            seconds=DECODING_SECONDS,
            whose=Whose(caller.study_id, caller.device_id),
            photograph_sha256=photo.stored_sha256,
            is_costly=is_costly([photo.path]),
        )
    except TadaError:  # of no child, or of our own mistake in it, which is in the log: neither may cost a meal
        return
    if found["failure"] is not None:
        raise InvalidInputError(
            f"The {slot} photograph: {found['failure']['message']} {found['failure']['advice']}",
            code=found["failure"]["code"],
            slot=slot,
        )


def _another(key: str) -> str:
    folder, _, sha256 = key.rpartition("/")
    return f"{folder}/{uuid.uuid4().hex}/{sha256}"
