"""A received photograph is decoded before it is acknowledged: afterwards the phone deletes its own.

receive_photo.py has seen that the file has its beginning and its end. A hole between them shows only when the pixels
are decoded, which a child does. Where no child can tell, the photograph is kept as it is: the estimate will tell.
"""

from collections.abc import Container, Mapping

from app.children.api_children import ApiChildren, Whose
from app.children.decoding_cost import is_costly
from app.core.errors import InvalidInputError, TadaError
from app.meals.receive_photo import SealablePhoto
from app.people.access.caller import DeviceCaller

SECONDS = 10.0  # of processor time; 60 megapixels in 20 scans take some five on a slow machine
JPEG = "image/jpeg"  # other formats have checksums, or a decoder that fails where data lack


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


def _require_whole(children: ApiChildren, caller: DeviceCaller, slot: str, photo: SealablePhoto) -> None:
    try:
        found = children.run(
            "whole",
            {"photo": str(photo.path)},
            seconds=SECONDS,
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
