"""Turn received files into sealed photographs: inspect, cut locations, decode once, put into the blob store.

This process never looks into the bytes. A child does, in one go (estimate/receive_task.py), before
the photograph is acknowledged, since the phone then deletes its own copy. What it learns is stored
with the photograph.
"""

import errno
import hashlib
import uuid
from collections.abc import Collection, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren, PhotographError, Whose
from app.core.errors import (
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
from app.meals.stored.models import DepthCameraDetails, MealImage
from app.people import privacy_queries as privacy
from app.people.access.caller import DeviceCaller
from app.people.location_policy import LocationPolicy
from app.photos.depth import DEPTH_ADVICE, MAX_MAP_PIXELS
from app.photos.gps import Location
from app.photos.slots import DEPTH_SLOTS, image_name
from app.storage.blob_store import BlobStore

SECONDS = 20.0  # of processor time; 60 megapixels in 20 scans take some five on a slow machine, twice if cut
RETRY_SECONDS = 1


@dataclass(frozen=True, slots=True)
class SealablePhoto:
    """An inspected photograph in the staging folder.

    width_px, height_px: of the upright picture; 0: a voice note.
    path: None if it is stored already, and was not looked at again
    decoding_pixels: of a baseline JPEG that takes as long to decode; None: a map or a voice note
    is_reencoded: cutting its location took writing its picture anew
    location: from its tags before they were cut, if the study's policy uses it
    """

    path: Path | None
    media_type: str
    width_px: int
    height_px: int
    bytes: int
    received_sha256: str
    stored_sha256: str
    decoding_pixels: int | None = None
    is_reencoded: bool = False
    location: Location | None = None


class PhotoIntake:
    """Inspects and seals the photographs of uploads; one per process."""

    def __init__(
        self, database: Database, blobs: BlobStore, settings: Settings, children: ApiChildren
    ) -> None:
        self._database = database
        self._blobs = blobs
        self._settings = settings
        self._children = children

    def prepare(
        self,
        caller: DeviceCaller,
        files: Mapping[str, ReceivedFile],
        policy: LocationPolicy,
        stored: Mapping[str, MealImage],
        depth_camera: DepthCameraDetails | None = None,
    ) -> dict[str, SealablePhoto]:
        """Have a child inspect and decode the received files, by slot, and cut their location by the study's policy.

        stored: the meal's photographs; the same bytes again are not looked at
        depth_camera: of depth maps

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError, PhotographError, each with
        the slot; UnavailableError (`server_busy`: no child was free in time).
        """
        prepared = {}
        for slot, file in files.items():
            row = stored.get(slot)
            if row is not None and row.received_sha256 == file.sha256:
                prepared[slot] = _as_stored(row)
            else:
                prepared[slot] = self._prepare(caller, slot, file, policy, depth_camera)
        return prepared

    def _prepare(
        self,
        caller: DeviceCaller,
        slot: str,
        file: ReceivedFile,
        policy: LocationPolicy,
        depth_camera: DepthCameraDetails | None,
    ) -> SealablePhoto:
        if file.bytes == 0:
            raise InvalidInputError(
                f"The {image_name(slot)} is empty: send its bytes.", code="part_empty", slot=slot
            )
        request = {
            "file": str(file.path),
            "slot": slot,
            "max_pixels": self._settings.max_photo_pixels,
            "reads_location": policy.reads_tags,
            "cuts_location": policy.cuts_tags,
            "depth_camera": depth_camera,
            "is_costly": False,
        }
        received = self._received(caller, slot, file, request)
        if received["is_costly"]:
            received = self._received(caller, slot, file, request | {"is_costly": True})
        if received["failure"] is not None:
            raise self._refusal(slot, **received["failure"])
        location = Location(*received["location"]) if received["location"] is not None else None
        return SealablePhoto(
            file.path, received_sha256=file.sha256, location=location, **received["facts"]
        )

    def _received(
        self, caller: DeviceCaller, slot: str, file: ReceivedFile, request: Mapping[str, object]
    ) -> Mapping[str, Any]:
        try:
            return self._children.run(
                "receive",
                request,
                seconds=SECONDS,
                whose=Whose(caller.study_id, caller.device_id),
                photograph_sha256=file.sha256,
                is_costly=request["is_costly"] is True,
            )
        except PhotographError as error:  # it needs too much memory or time, or breaks the reader
            if slot in DEPTH_SLOTS:
                raise self._refusal(
                    slot, "depth_unreadable", "It cannot be read here.", DEPTH_ADVICE
                ) from error
            raise PhotographError(f"The {image_name(slot)}: {error.message}", slot=slot) from error

    def _refusal(self, slot: str, code: str, message: str, advice: str) -> TadaError:
        sentence = f"The {image_name(slot)}: {message} {advice}".strip()
        if code == "not_an_image":
            return UnsupportedMediaError(sentence, code=code, slot=slot)
        if code == "image_too_many_pixels":
            limit = MAX_MAP_PIXELS if slot in DEPTH_SLOTS else self._settings.max_photo_pixels
            return TooLargeError(sentence, code=code, slot=slot, limit_pixels=limit)
        return InvalidInputError(sentence, code=code, slot=slot)

    @contextmanager
    def sealed(
        self,
        photos: Mapping[str, SealablePhoto],
        keys: Mapping[str, str],
        stored: Container[str],
    ) -> Iterator[None]:
        """Seal the photographs whose slot is not in `stored`, for rows that are written within.

        photos, keys: by slot
        Raises StorageFullError, UnavailableError (a photograph that was stored is being replaced).
        """
        paths = {keys[slot]: photo.path for slot, photo in photos.items() if slot not in stored}
        files = {key: path for key, path in paths.items() if path is not None}
        if len(files) < len(paths):
            raise UnavailableError(
                "Another pair came in at the same time. Nothing was kept; send it again.",
                retry_after_seconds=RETRY_SECONDS,
            )
        try:
            self._blobs.put_files(files)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise storage_full() from error
            raise
        try:
            yield
        except GoneError:  # erased meanwhile: the deleter spares blobs that a row still names
            with self._database.write() as session:
                privacy.schedule_deletion(session, list(keys.values()), datetime.now(UTC))
            raise


def sha256_of_file(path: Path) -> str:
    """Return the hexadecimal digest, without reading the whole file into memory."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unspent_keys(session: Session, keys: Mapping[str, str]) -> dict[str, str]:
    """Return the keys to seal under, by slot.

    A key that a deleted orphan of the same bytes used is replaced.
    """
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
            retry_after_seconds=RETRY_SECONDS,
        )


def image_rows(
    meal_id: uuid.UUID,
    photos: Mapping[str, SealablePhoto],
    keys: Mapping[str, str],
    *,
    but: Container[str],
) -> list[MealImage]:
    """Return the rows of photographs that are sealed under the keys, but for slots that have one."""
    now = datetime.now(UTC)
    return [
        MealImage(
            id=uuid.uuid4(),
            meal_id=meal_id,
            slot=slot,
            media_type=photo.media_type,
            width_px=photo.width_px,
            height_px=photo.height_px,
            bytes=photo.bytes,
            received_sha256=photo.received_sha256,
            stored_sha256=photo.stored_sha256,
            blob_key=keys[slot],
            decoding_pixels=photo.decoding_pixels,
            is_reencoded=photo.is_reencoded,
            received_at=now,
        )
        for slot, photo in photos.items()
        if slot not in but
    ]


def _as_stored(image: MealImage) -> SealablePhoto:
    sizes = image.width_px, image.height_px, image.bytes
    return SealablePhoto(None, image.media_type, *sizes, image.received_sha256, image.stored_sha256)


def _fresh_key(key: str) -> str:
    folder, _, sha256 = key.rpartition("/")
    return f"{folder}/{uuid.uuid4().hex}/{sha256}"
