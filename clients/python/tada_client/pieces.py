"""A large photograph in pieces, by tus 1.0 (docs/apps.md): after a cut connection it continues where the server's end.

Attempts that bring it no further are counted by the client's RetryPolicy.
"""

import base64
import hashlib
import io
import time
from http import HTTPStatus
from pathlib import Path

from tada_client import schemas
from tada_client.caller import Caller, path_of
from tada_client.errors import NetworkError, Problem

LARGE_BYTES = 1024**2  # a smaller photograph is sent whole: three more requests would take longer
PIECE_BYTES = 2 * 1024**2  # a proxy that waits for whole requests loses no more than this
TUS = {"Tus-Resumable": "1.0.0"}
# another host, another process of this program, or an upload that was begun with other bytes and is given up
IS_ELSEWHERE = {"upload_unknown", "upload_offset_differs", "upload_digest_differs"}


def is_large(photograph: Path | bytes) -> bool:
    """Return true if a photograph is to be sent in pieces."""
    return size_of(photograph) > LARGE_BYTES


def size_of(photograph: Path | bytes) -> int:
    """Return the number of its bytes."""
    return photograph.stat().st_size if isinstance(photograph, Path) else len(photograph)


def send_in_pieces(
    caller: Caller, meal: object, slot: str, photograph: Path | bytes, *, seconds: float
) -> schemas.MealOut | None:
    """Send the bytes that the server lacks. Return the meal once the photograph is on its disk; None: send it whole.

    An upload of another length is begun anew. meal: its id. Raises Problem, NetworkError, OSError.
    """
    upload, size, digest = (
        path_of("meals", meal, "images", slot, "upload"),
        size_of(photograph),
        _sha256(photograph),
    )
    of_whole = {
        "Repr-Digest": f"sha-256=:{base64.b64encode(digest).decode()}:"
    }  # RFC 9530; older servers ignore it
    offset = _offset_of(caller, upload, size)
    if offset is None:
        if not _begin(caller, upload, size):
            return None
        offset = 0
    farthest, failures = offset, 0
    while offset < size:
        piece = _read(photograph, offset)
        headers = (
            TUS
            | of_whole
            | {"Content-Type": "application/offset+octet-stream", "Upload-Offset": str(offset)}
        )
        try:
            caller.call("PATCH", upload, file=piece, headers=headers, seconds=seconds, attempts=1)
            offset += len(piece)
        except (Problem, NetworkError) as error:
            failures += 1
            if isinstance(error, Problem) and error.code in IS_ELSEWHERE:
                if failures >= caller.retries.attempts:
                    return None
            elif (pause := caller.retries.seconds_until_next(error, failures)) is None:
                raise
            else:
                time.sleep(pause)
            offset = _offset_of(caller, upload, size)
            if offset is None:  # the last answer was lost, or another host answers now
                break
            if offset > farthest:
                farthest, failures = offset, 0
    sent: schemas.MealOut = caller.call("GET", path_of("meals", meal))
    return sent if _has_bytes(sent, slot, digest) else None


def _offset_of(caller: Caller, upload: str, size: int) -> int | None:
    """Return how many bytes the server has; None: it has no unfinished upload of this size, or takes none."""
    try:
        offset, length = caller.numbers_in_headers("GET", upload, "Upload-Offset", "Upload-Length")
    except Problem as problem:
        if problem.status in {HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED}:
            return None
        raise
    return offset if length == size else None


def _begin(caller: Caller, upload: str, size: int) -> bool:
    """Begin an upload; False: the server takes no pieces, or no further ones now."""
    try:
        caller.call("POST", upload, headers=TUS | {"Upload-Length": str(size)})
    except Problem as problem:
        if problem.status in {HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED}:
            return False
        if problem.code == "uploads_too_many":
            return False
        raise
    return True


def _read(photograph: Path | bytes, offset: int) -> bytes:
    if isinstance(photograph, bytes):
        return photograph[offset : offset + PIECE_BYTES]
    with photograph.open("rb") as file:
        file.seek(offset)
        return file.read(PIECE_BYTES)


def _sha256(photograph: Path | bytes) -> bytes:
    with io.BytesIO(photograph) if isinstance(photograph, bytes) else photograph.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _has_bytes(meal: schemas.MealOut, slot: str, digest: bytes) -> bool:
    image = (meal["images"] | (meal["after"]["images"] if meal["after"] is not None else {})).get(
        slot
    )
    return image is not None and image["durable"] and image["received_sha256"] == digest.hex()
