"""A stored file as an answer: whole or a part of it (RFC 9110, 14), so that a download that broke off goes on.

The ETag is the SHA-256 of the bytes, so a part fits to those that are there already, or is not given.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from fastapi import Request
from fastapi.responses import Response

from app.core.errors import RangeNotSatisfiableError
from app.http.closing_stream import ClosingStream
from app.http.conditions import is_held
from app.http.file_formats import FORMATS, JSON
from app.http.stored_file import StoredFile
from app.storage.blob_store import BlobStore

RANGE = re.compile(r"bytes=(\d{0,19})-(\d{0,19})")
MEDIA_TYPES: Mapping[str, str] = {  # by the name's end
    "json": JSON,
    **{suffix: form.media_type for suffix, form in FORMATS.items()},
}
PART, UNCHANGED = 206, 304


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes of a file from `start` on."""

    start: int
    length: int


def requested_range(request: Request, length: int, etag: str) -> Piece | None:
    """The part that is asked for; None: the whole file.

    Several ranges, other units and what is no range at all are answered by the whole, as RFC 9110 allows; so is a
    range of another file than this (If-Range). Raises RangeNotSatisfiableError.
    """
    match = RANGE.fullmatch(request.headers.get("range", "").replace(" ", ""))
    if match is None or request.headers.get("if-range", etag) != etag:
        return None
    first, last = match.groups()
    if not first and not last:
        return None
    if not first:  # the last so many bytes
        start, end = max(length - int(last), 0), length
        is_there = int(last) > 0 and length > 0
    else:
        start, end = int(first), min(int(last) + 1, length) if last else length
        if last and int(last) < start:
            return None  # no range at all
        is_there = start < length
    if not is_there:
        raise RangeNotSatisfiableError("The file does not go so far.", length=length)
    return Piece(start, end - start)


def answer_part(
    request: Request, content: bytes, media_type: str, headers: Mapping[str, str]
) -> Response:
    """Return the content, or the part of it that is asked for. headers: with ETag. Raises RangeNotSatisfiableError."""
    headers = {**headers, "Accept-Ranges": "bytes"}
    piece = requested_range(request, len(content), headers["ETag"])
    if piece is None:
        return Response(content, media_type=media_type, headers=headers)
    end = piece.start + piece.length
    headers["Content-Range"] = f"bytes {piece.start}-{end - 1}/{len(content)}"
    return Response(content[piece.start : end], PART, media_type=media_type, headers=headers)


def answer_stored_file(request: Request, blobs: BlobStore, file: StoredFile) -> Response:
    """The file, or what is asked of it. Raises RangeNotSatisfiableError, BlobMissingError, OSError."""
    etag = f'"{file.sha256}"'
    media_type = MEDIA_TYPES[file.name.rpartition(".")[2]]
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",  # erased is erased: each use asks first
    }
    if is_held(request.headers.get("if-none-match"), etag):
        return Response(status_code=UNCHANGED, headers=headers)
    piece = requested_range(request, file.length, etag)
    start, length = (0, file.length) if piece is None else (piece.start, piece.length)
    pieces = file.pieces(blobs, start, length)
    headers |= {
        "Content-Length": str(length),
        "Content-Disposition": f'attachment; filename="{file.name}"',
    }
    if piece is None:
        return ClosingStream(pieces, pieces.close, media_type=media_type, headers=headers)
    headers["Content-Range"] = f"bytes {start}-{start + length - 1}/{file.length}"
    return ClosingStream(
        pieces, pieces.close, media_type=media_type, headers=headers, status_code=PART
    )
