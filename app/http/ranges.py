"""A stored file as an answer: whole or a part of it (RFC 9110, 14).

So a download that broke off goes on. The ETag is the SHA-256 of the bytes, so a part fits to those
that are there already, or is not given.
"""

import os
import re
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass

import anyio
from fastapi import Request
from fastapi.responses import Response, StreamingResponse
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from app.core.errors import RangeNotSatisfiableError
from app.http.file_formats import FORMATS, JSON
from app.http.parameters import is_held
from app.storage.blob_store import BlobStore

RANGE = re.compile(r"bytes=(\d{0,19})-(\d{0,19})")
MEDIA_TYPES: Mapping[str, str] = {  # by the name's end
    "json": JSON,
    **{suffix: form.media_type for suffix, form in FORMATS.items()},
}
PART, UNCHANGED = 206, 304


class ClosingStream(StreamingResponse):
    """Streams bytes; calls `close` once, whatever happens.

    Starlette leaves a source that it did not read to the end to the garbage collector, which may
    come to it hours later: until then it holds what it has open, such as a file without a name with
    all photographs of a person.
    """

    def __init__(
        self,
        source: Iterator[bytes],
        close: Callable[[], object],
        *,
        media_type: str,
        headers: Mapping[str, str],
        status_code: int = 200,
    ) -> None:
        super().__init__(source, status_code, media_type=media_type, headers=headers)
        self._close = close

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Stream, then close: in a thread, shielded from the cancellation that a caller who left causes."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            with anyio.CancelScope(shield=True):
                await anyio.to_thread.run_sync(self._close)


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file that the caller may fetch. length: bytes of it; sha256: of all of them."""

    name: str
    length: int
    sha256: str
    blob_key: str

    def pieces(self, blobs: BlobStore, start: int, length: int) -> Generator[bytes, None, None]:
        """So many bytes from there on. Raises BlobMissingError."""
        if (start, length) == (0, self.length):
            return blobs.stream(self.blob_key)
        return blobs.stream_part(self.blob_key, start, length)


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes of a file from `start` on."""

    start: int
    length: int


def requested_range(request: Request, length: int, etag: str) -> Piece | None:
    """The part that is asked for; None: the whole file.

    Several ranges, other units and what is no range at all are answered by the whole, as RFC 9110
    allows; so is a range of another file than this (If-Range). Raises RangeNotSatisfiableError.
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
    """Return the content, or the part of it that is asked for.

    headers: with ETag. Raises RangeNotSatisfiableError.
    """
    headers = {**headers, "Accept-Ranges": "bytes"}
    piece = requested_range(request, len(content), headers["ETag"])
    if piece is None:
        return Response(content, media_type=media_type, headers=headers)
    end = piece.start + piece.length
    headers["Content-Range"] = f"bytes {piece.start}-{end - 1}/{len(content)}"
    return Response(content[piece.start : end], PART, media_type=media_type, headers=headers)


def answer_stored_file(request: Request, blobs: BlobStore, file: StoredFile) -> Response:
    """The file, or what is asked of it.

    Raises RangeNotSatisfiableError, BlobMissingError, OSError.
    """
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


class PublicFiles(StaticFiles):
    """Starlette's static files without names that begin with a dot."""

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """As StaticFiles; "." is the folder itself."""
        if any(part.startswith(".") and part != "." for part in path.split("/")):
            return "", None
        return super().lookup_path(path)
