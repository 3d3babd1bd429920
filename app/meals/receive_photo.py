"""One received file to a photograph that may be sealed: what it is, whole or not, within limits, without its location.

The bytes are walked, never decoded: decoding is the child's business (children/child.py).
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from app.core.errors import InvalidInputError, TooLargeError, UnsupportedMediaError
from app.people.location_policy import LocationPolicy
from app.photos.gps import Location
from app.photos.inspect import PhotoFacts, inspect_photo
from app.photos.location import read_location, remove_location

SIDEWAYS = frozenset({5, 6, 7, 8})  # EXIF orientations that turn by a quarter


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file in the staging folder, as it came: its SHA-256 and length were taken while it was written."""

    path: Path
    sha256: str
    bytes: int


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
