"""The layout of a PNG file (ISO/IEC 15948): its chunks and size.

The checksums of the header, the palette and the pixels are verified: bytes lost on the way show here, before the upload
is acknowledged. Other chunks may be broken; nothing is decompressed.
"""

import zlib

from app.core.errors import Failure
from app.photos.byte_file import STEP_BYTES, Data, Edits
from app.photos.chunks import Chunk, ChunkLayout
from app.photos.damage import truncated, unreadable

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 13
MAX_LENGTH = 0x7FFFFFFF  # the standard's limit
PIXELS = frozenset({b"PLTE", b"IDAT"})  # decoders need them unaltered
ANIMATION = frozenset({b"acTL", b"fcTL", b"fdAT"})  # APNG: each frame is another picture to decode
MAX_CHUNKS = 65_536  # 60 MB in the smallest pieces that encoders write (4 KiB) make 15,000


def read_png_layout(data: Data) -> ChunkLayout:
    """Walk the chunks to IEND. The file begins with the signature."""
    chunks: list[Chunk] = []
    size = (0, 0)
    position = len(SIGNATURE)
    has_pixels = False

    def layout(damage: Failure | None) -> ChunkLayout:
        return ChunkLayout(tuple(chunks), *size, position, damage)

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
        chunk = Chunk(kind, start, end)
        damage = _damage_of_chunk(data, chunk) if chunks else _damage_of_header(data, chunk)
        if damage is not None:
            return layout(damage)
        if not chunks:
            size = _size(data, chunk)
        chunks.append(chunk)
        position = end + 4
        has_pixels = has_pixels or (kind == b"IDAT" and length > 0)
        if kind == b"IEND":
            return layout(None if has_pixels else unreadable("the PNG has no picture before its end chunk"))
    return layout(unreadable(f"the PNG has more than {MAX_CHUNKS} chunks"))


def renew_checksum(edits: Edits, chunk: Chunk) -> None:
    """Make the chunk's checksum fit its edited type and data."""
    edits.write([(chunk.end, chunk.end + 4)], _checksum(edits.data, chunk.start, chunk.end).to_bytes(4))


def _damage_of_header(data: Data, chunk: Chunk) -> Failure | None:
    """Why the file's first chunk gives no size."""
    if chunk.kind != b"IHDR" or chunk.end - chunk.start != HEADER_BYTES or not _fits_checksum(data, chunk):
        return unreadable("the PNG's header is broken")
    return unreadable("the PNG's header gives no size") if 0 in _size(data, chunk) else None


def _damage_of_chunk(data: Data, chunk: Chunk) -> Failure | None:
    """Why the picture cannot be used with this chunk, which is not the header."""
    if chunk.kind in ANIMATION:
        return unreadable("the PNG is animated")
    if chunk.kind in PIXELS and not _fits_checksum(data, chunk):
        return unreadable("a part of the PNG's pixels does not fit its checksum")
    return None


def _checksum(data: Data, start: int, end: int) -> int:
    """The checksum of a chunk's type and data, in steps, so that other threads run between them."""
    checksum = 0
    for step in range(start - 4, end, STEP_BYTES):
        checksum = zlib.crc32(data[step : min(step + STEP_BYTES, end)], checksum)
    return checksum


def _fits_checksum(data: Data, chunk: Chunk) -> bool:
    return _checksum(data, chunk.start, chunk.end) == int.from_bytes(data[chunk.end : chunk.end + 4])


def _size(data: Data, header: Chunk) -> tuple[int, int]:
    """Width and height, px."""
    start = header.start
    return int.from_bytes(data[start : start + 4]), int.from_bytes(data[start + 4 : start + 8])
