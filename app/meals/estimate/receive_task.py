"""A file as it arrives, in one go: what it is, whether all of it can be decoded, and its location taken out of it.

This is all that ever reads a photograph's structure on arrival; what was learnt is stored with it.
"""

import hashlib
from pathlib import Path

import numpy as np
from pydantic import BaseModel, JsonValue

from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.estimate.estimate_json import failure_to_json
from app.meals.stored.run_answer import Json
from app.photos.depth import MAX_MAP_PIXELS, inspect_depth
from app.photos.inspect import COSTLY_PIXELS, JPEG, PNG, WEBP, PhotoFacts, inspect_photo
from app.photos.location import read_location, remove_location
from app.photos.slots import CONFIDENCE_SLOTS, DEPTH_SLOTS, VOICE_NOTE
from app.photos.voice_note import inspect_voice_note, remove_note_metadata
from app.photos.webp import LOSSLESS_PICTURE, read_webp_layout
from app.vision.model import Photo
from app.vision.photograph.depth_camera import depth_camera_from_mapping
from app.vision.photograph.depth_map import read_confidence, read_depth
from app.vision.photograph.photo import (
    ReducedPhoto,
    encode_photo,
    read_photo,
    read_reduced_photo,
    read_taken_at,
)

SIDEWAYS = frozenset({5, 6, 7, 8})  # EXIF orientations that turn by a quarter


class _ReceiveRequest(BaseModel):
    """reads_location, cuts_location: by the study's policy. depth_camera: of the meal's maps.

    is_costly: the request may take long.
    """

    file: Path
    slot: str
    max_pixels: int
    reads_location: bool
    cuts_location: bool
    depth_camera: dict[str, float] | None
    is_costly: bool


class _InspectRequest(BaseModel):
    photos: list[Path]


def inspect_task(arguments: Arguments, _: StageListener) -> Json:
    """Return the upright sizes of the photographs that are whole, and what decoding them costs."""
    inspected = [inspect_photo(path) for path in _InspectRequest.model_validate(arguments).photos]
    whole = [facts for facts in inspected if isinstance(facts, PhotoFacts)]
    sizes: list[JsonValue] = [list(_upright(facts)) for facts in whole]
    return {"sizes": sizes, "decoding_pixels": sum(facts.decoding_pixels for facts in whole)}


def receive_task(arguments: Arguments, _: StageListener) -> Json:
    """Return a file's facts, the file without location, or the failure for which it is refused.

    Answers {"is_costly": true} instead, and leaves the file alone, if it takes long and the request
    may not.
    """
    request = _ReceiveRequest.model_validate(arguments)
    if request.slot == VOICE_NOTE:
        answer = _receive_note(request)
    elif request.slot in DEPTH_SLOTS:
        answer = _receive_map(request)
    else:
        answer = _receive_photo(request)
    if isinstance(answer, Failure):
        answer = {"failure": failure_to_json(answer)}
    return {"failure": None, "is_costly": False, "location": None} | answer


def _receive_photo(request: _ReceiveRequest) -> Json | Failure:
    facts = inspect_photo(request.file)
    if isinstance(facts, Failure):
        return facts
    if facts.pixels_to_decode > request.max_pixels:
        return _too_many_pixels(facts, request.max_pixels)
    if facts.decoding_pixels > COSTLY_PIXELS and not request.is_costly:
        return {"is_costly": True}
    original = request.file.read_bytes()
    picture = _picture(original, request.max_pixels)
    if isinstance(picture, Failure):
        return picture
    location = read_location(request.file, facts) if request.reads_location else None
    media_type = facts.media_type
    is_reencoded = (
        request.cuts_location
        and remove_location(request.file, facts)
        and not _is_only_cut(request, facts, picture)
    )
    if is_reencoded:
        photo = read_photo(original, max_pixels=request.max_pixels)
        if isinstance(photo, Failure):
            return photo
        is_lossless = _is_lossless(original, media_type)
        taken_at = read_taken_at(original)
        encoded = encode_photo(
            photo, is_lossless=is_lossless, orientation=facts.orientation, taken_at=taken_at
        )
        request.file.write_bytes(encoded)
        media_type = PNG if is_lossless else JPEG
    position: Json = {}
    if location is not None:
        position["location"] = [location.latitude_deg, location.longitude_deg]
    more_facts = {"decoding_pixels": facts.decoding_pixels, "is_reencoded": is_reencoded}
    return position | _facts(request.file, media_type, _upright(facts), **more_facts)


def _is_only_cut(request: _ReceiveRequest, facts: PhotoFacts, picture: Photo) -> bool:
    """Whether the file, read again, lacks its location and nothing else.

    facts, picture: before the cut.
    """
    if inspect_photo(request.file) != facts or remove_location(request.file, facts):
        return False
    cut = _picture(request.file.read_bytes(), request.max_pixels, is_whole=True)
    return (
        isinstance(cut, Photo)
        and np.array_equal(cut.pixels_bgr, picture.pixels_bgr)
        and (cut.focal_35mm, cut.model) == (picture.focal_35mm, picture.model)
    )


def _is_lossless(data: bytes, media_type: str) -> bool:
    return media_type == PNG or (
        media_type == WEBP
        and any(part.kind == LOSSLESS_PICTURE for part in read_webp_layout(data).parts)
    )


def _picture(data: bytes, max_pixels: int, *, is_whole: bool = False) -> Photo | Failure:
    """The photograph, all of it read, at an eighth of its size: half of the time of a JPEG."""
    read = read_reduced_photo(data, max_pixels=max_pixels, least_long_side_px=1, is_whole=is_whole)
    return read.photo if isinstance(read, ReducedPhoto) else read


def _receive_map(request: _ReceiveRequest) -> Json | Failure:
    is_confidence = request.slot in CONFIDENCE_SLOTS
    facts = inspect_depth(request.file, is_confidence=is_confidence)
    if isinstance(facts, Failure):
        return facts
    if facts.pixels_to_decode > MAX_MAP_PIXELS:
        return _too_many_pixels(facts, MAX_MAP_PIXELS)
    if request.cuts_location:
        remove_location(request.file, facts)
    if request.depth_camera is not None:  # else it was not announced, and is refused for that
        camera, data = depth_camera_from_mapping(request.depth_camera), request.file.read_bytes()
        read = read_confidence(data, camera) if is_confidence else read_depth(data, camera)
        if isinstance(read, Failure):
            return read
    return _facts(request.file, facts.media_type, _upright(facts))


def _receive_note(request: _ReceiveRequest) -> Json | Failure:
    media_type = inspect_voice_note(request.file)
    if isinstance(media_type, Failure):
        return media_type
    if request.cuts_location:
        removed = remove_note_metadata(request.file, media_type)
        if isinstance(removed, Failure):
            return removed
    return _facts(request.file, media_type, (0, 0))


def _facts(path: Path, media_type: str, size: tuple[int, int], **more: int) -> Json:
    """Return the fields of a SealablePhoto, as "facts"."""
    content = path.read_bytes()
    facts: Json = {
        "media_type": media_type,
        "width_px": size[0],
        "height_px": size[1],
        "bytes": len(content),
        **more,
    }
    facts["stored_sha256"] = hashlib.sha256(content).hexdigest()
    return {"facts": facts}


def _upright(facts: PhotoFacts) -> tuple[int, int]:
    return (
        (facts.height, facts.width)
        if facts.orientation in SIDEWAYS
        else (facts.width, facts.height)
    )


def _too_many_pixels(facts: PhotoFacts, limit: int) -> Failure:
    message = f"It has {facts.pixels_to_decode} pixels; at most {limit} are allowed."
    return Failure(
        "image_too_many_pixels", message, "Choose a smaller picture size in the camera's settings."
    )
