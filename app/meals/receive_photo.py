"""Turn received files into sealed photographs: inspect, cut locations, decode once, put into the blob store.

This process walks the bytes but never decodes them. A hole in the middle of a file only shows when its pixels are
decoded; a child does that before the photograph is acknowledged, since the phone then deletes its own copy. If no child
is available, the photograph is kept undecoded and the estimate will report any damage.
"""

import errno
import hashlib
import uuid
from collections.abc import Callable, Collection, Container, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren, PhotographError, Whose
from app.children.decoding_cost import is_costly
from app.core.errors import (
    Failure,
    GoneError,
    InvalidInputError,
    TadaError,
    TooLargeError,
    UnavailableError,
    UnsupportedMediaError,
)
from app.core.settings import Settings
from app.db import spent_keys
from app.db.session import Database
from app.http.upload import ReceivedFile, storage_full
from app.meals.models import DepthCameraDetails, MealImage
from app.people import privacy_queries as privacy
from app.people.access.caller import DeviceCaller
from app.people.location_policy import LocationPolicy
from app.photos.depth import DEPTH_ADVICE, MAX_MAP_PIXELS, inspect_depth
from app.photos.gps import Location
from app.photos.inspect import PhotoFacts, inspect_photo
from app.photos.location import read_location, remove_location
from app.photos.slots import CONFIDENCE_SLOTS, DEPTH_SLOTS, VOICE_NOTE, image_name
from app.photos.voice_note import inspect_voice_note, remove_note_metadata
from app.storage.blob_store import BlobStore

Result = TypeVar("Result")

SIDEWAYS = frozenset({5, 6, 7, 8})  # EXIF orientations that turn by a quarter
DECODING_SECONDS = 10.0  # of processor time; 60 megapixels in 20 scans take some five on a slow machine
JPEG = "image/jpeg"  # other formats have checksums, or a decoder that fails if data are missing
SPENT_RETRY_SECONDS = 1


@dataclass(frozen=True, slots=True)
class SealablePhoto:
    """An inspected photograph in the staging folder. width_px, height_px: of the upright picture; 0: a voice note.

    location: from its tags before they were cut, if the study's policy uses it.
    """

    path: Path
    media_type: str
    width_px: int
    height_px: int
    bytes: int
    received_sha256: str
    stored_sha256: str
    location: Location | None = None


class PhotoIntake:
    """Inspects and seals the photographs of uploads; one per process."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings, children: ApiChildren) -> None:
        self._database = database
        self._blobs = blobs
        self._settings = settings
        self._children = children

    def prepare(self, files: Mapping[str, ReceivedFile], policy: LocationPolicy) -> dict[str, SealablePhoto]:
        """Inspect the received files, by slot, and cut their location tags by the study's policy.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError, each with the slot.
        """
        max_pixels = self._settings.max_photo_pixels
        return {slot: _prepare_image(slot, file, max_pixels, policy) for slot, file in files.items()}

    def seal_and_write(
        self,
        caller: DeviceCaller,
        photos: Mapping[str, SealablePhoto],
        keys: Mapping[str, str],
        stored: Container[str],
        write: Callable[[], Result],
        depth_camera: DepthCameraDetails | None = None,
    ) -> Result:
        """Seal the photographs whose slot is not in `stored`, then write the rows that name them.

        photos, keys: by slot. write: one transaction; it runs again if an identical upload commits first.
        depth_camera: of the depth maps among them.

        Raises InvalidInputError (`image_unreadable`: a JPEG lacks some of its pixels; `depth_unreadable`,
        `depth_empty`), StorageFullError, and whatever `write` raises.
        """
        new_photos = {slot: photo for slot, photo in photos.items() if slot not in stored}
        if self._children.are_up:
            for slot, photo in new_photos.items():
                if photo.media_type == JPEG or slot in DEPTH_SLOTS:
                    _require_whole(self._children, caller, slot, photo, depth_camera)
        try:
            self._blobs.put_files({keys[slot]: photo.path for slot, photo in new_photos.items()})
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise storage_full() from error
            raise
        try:
            try:
                return write()
            except IntegrityError:  # an identical upload was written at the same time and committed first
                return write()
        except GoneError:  # erased while the photographs were sealed: the deleter spares blobs that a row still names
            with self._database.write() as session:
                privacy.schedule_deletion(session, list(keys.values()), datetime.now(UTC))
            raise


def sha256_of_file(path: Path) -> str:
    """Return the hexadecimal digest, without reading the whole file into memory."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unspent_keys(session: Session, keys: Mapping[str, str]) -> dict[str, str]:
    """Return the keys to seal under, by slot. A key that a deleted orphan of the same bytes used is replaced."""
    spent = spent_keys.spent_among(session, keys.values())
    return {slot: _fresh_key(key) if key in spent else key for slot, key in keys.items()}


def require_unspent(session: Session, keys: Collection[str]) -> None:
    """Raise UnavailableError if a key was deleted as an orphan since it was sealed.

    Must run in the transaction that writes the rows naming the keys.
    """
    spent_keys.hold(session, keys)
    if spent_keys.spent_among(session, keys):
        raise UnavailableError(
            "A photograph of an earlier try was just being removed. Nothing was kept; send it again.",
            retry_after_seconds=SPENT_RETRY_SECONDS,
        )


def image_row(meal_id: uuid.UUID, slot: str, photo: SealablePhoto, key: str, now: datetime) -> MealImage:
    """Return the row of a photograph that is sealed under the key."""
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


def _prepare_image(slot: str, file: ReceivedFile, max_pixels: int, policy: LocationPolicy) -> SealablePhoto:
    if file.bytes == 0:
        raise InvalidInputError(f"The {image_name(slot)} is empty: send its bytes.", code="part_empty", slot=slot)
    if slot == VOICE_NOTE:
        return _prepare_note(file, policy)
    is_map = slot in DEPTH_SLOTS
    if is_map:
        facts, max_pixels = inspect_depth(file.path, is_confidence=slot in CONFIDENCE_SLOTS), MAX_MAP_PIXELS
    else:
        facts = inspect_photo(file.path)
    if not isinstance(facts, PhotoFacts):
        message = f"The {image_name(slot)}: {facts.message}" + (f" {facts.advice}" if facts.advice else "")
        if facts.code == "not_an_image":
            raise UnsupportedMediaError(message, code=facts.code, slot=slot)
        raise InvalidInputError(message, code=facts.code, slot=slot)
    if facts.pixels_to_decode > max_pixels:
        raise TooLargeError(
            f"The {image_name(slot)} has {facts.pixels_to_decode} pixels; at most {max_pixels} are allowed.",
            code="image_too_many_pixels",
            slot=slot,
            limit_pixels=max_pixels,
        )
    location = read_location(file.path, facts) if policy.reads_tags and not is_map else None
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


def _prepare_note(file: ReceivedFile, policy: LocationPolicy) -> SealablePhoto:
    media_type = inspect_voice_note(file.path)
    if isinstance(media_type, Failure):
        raise _unreadable_note(media_type)
    changed = policy.cuts_tags and remove_note_metadata(file.path, media_type)
    if isinstance(changed, Failure):
        raise _unreadable_note(changed)
    stored_sha256 = sha256_of_file(file.path) if changed else file.sha256
    return SealablePhoto(file.path, media_type, 0, 0, file.bytes, file.sha256, stored_sha256)


def _unreadable_note(failure: Failure) -> InvalidInputError:
    return InvalidInputError(f"{failure.message} {failure.advice}", code=failure.code, slot=VOICE_NOTE)


def _require_whole(
    children: ApiChildren,
    caller: DeviceCaller,
    slot: str,
    photo: SealablePhoto,
    depth_camera: DepthCameraDetails | None,
) -> None:
    is_map = slot in DEPTH_SLOTS
    try:
        result = children.run(
            "whole",
            {
                "photo": str(photo.path),
                "depth_camera": depth_camera if is_map else None,
                "is_confidence": slot in CONFIDENCE_SLOTS,
            },
            seconds=DECODING_SECONDS,
            whose=Whose(caller.study_id, caller.device_id),
            photograph_sha256=photo.stored_sha256,
            is_costly=not is_map and is_costly([photo.path]),
        )
    except PhotographError as error:  # reading it needs too much memory or time, or breaks the reader
        if not is_map:  # a photograph is decoded again in the estimate, where a failure is kept with the meal
            return
        raise InvalidInputError(
            f"The {image_name(slot)} cannot be read here. {DEPTH_ADVICE}", code="depth_unreadable", slot=slot
        ) from error
    except TadaError:  # no child was free, or it failed by a bug, which is logged: neither may cost a meal
        return
    if result["failure"] is not None:
        raise InvalidInputError(
            f"The {image_name(slot)}: {result['failure']['message']} {result['failure']['advice']}",
            code=result["failure"]["code"],
            slot=slot,
        )


def _fresh_key(key: str) -> str:
    folder, _, sha256 = key.rpartition("/")
    return f"{folder}/{uuid.uuid4().hex}/{sha256}"
