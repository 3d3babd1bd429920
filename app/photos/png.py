"""The layout of a PNG file (ISO/IEC 15948): its chunks and size. Only the first chunk's checksum is verified."""

import zlib
from dataclasses import dataclass

from app.errors import Failure
from app.photos.byte_file import STEP_BYTES, Data, Edits
from app.photos.damage import truncated, unreadable

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 13
MAX_LENGTH = 0x7FFFFFFF  # the standard's limit
MAX_CHUNKS = 65_536  # 60 MB in the smallest pieces that encoders write (4 KiB) make 15,000


@dataclass(frozen=True, slots=True)
class PngChunk:
    """A chunk's type and data: start and end without length, type and checksum."""

    kind: bytes
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class PngLayout:
    """What was read, up to the end chunk or the damage; `end` is the first byte that was not read."""

    chunks: tuple[PngChunk, ...]
    width: int
    height: int
    end: int
    damage: Failure | None


def read_png_layout(data: Data) -> PngLayout:
    """Walk the chunks to IEND. The file begins with the signature."""
    chunks: list[PngChunk] = []
    size = (0, 0)
    position = len(SIGNATURE)
    has_pixels = False

    def layout(damage: Failure | None) -> PngLayout:
        return PngLayout(tuple(chunks), *size, position, damage)

    for _ in range(MAX_CHUNKS):
        start = position + 8
        if start > len(data):
            return layout(truncated("the PNG's end chunk is missing"))
        length, kind = int.from_bytes(data[position : position + 4]), data[position + 4 : start]
        end = start + length
        if length > MAX_LENGTH or not kind.isalpha():
            return layout(unreadable("there is no PNG chunk where one must stand"))
        if end + 4 > len(data):
            return layout(truncated("a PNG chunk is cut"))
        if not chunks:
            if kind != b"IHDR" or length != HEADER_BYTES or zlib.crc32(data[start - 4 : end]) != _checksum(data, end):
                return layout(unreadable("the PNG's header is broken"))
            size = int.from_bytes(data[start : start + 4]), int.from_bytes(data[start + 4 : start + 8])
            if 0 in size:
                return layout(unreadable("the PNG's header gives no size"))
        chunks.append(PngChunk(kind, start, end))
        position = end + 4
        has_pixels = has_pixels or (kind == b"IDAT" and length > 0)
        if kind == b"IEND":
            return layout(None if has_pixels else unreadable("the PNG has no picture before its end chunk"))
    return layout(unreadable(f"the PNG has more than {MAX_CHUNKS} chunks"))


def renew_checksum(edits: Edits, chunk: PngChunk) -> None:
    """Make the chunk's checksum fit its edited type and data."""
    checksum = 0
    for start in range(chunk.start - 4, chunk.end, STEP_BYTES):
        checksum = zlib.crc32(edits.data[start : min(start + STEP_BYTES, chunk.end)], checksum)
    edits.write([(chunk.end, chunk.end + 4)], checksum.to_bytes(4))


def _checksum(data: Data, position: int) -> int:
    return int.from_bytes(data[position : position + 4])
