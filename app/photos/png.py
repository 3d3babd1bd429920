"""A PNG file (ISO/IEC 15948): its chunks, its size, and its text chunks without places.

The checksums of the header, the palette and the pixels are verified: bytes lost on the way show here, before the upload
is acknowledged. Other chunks may be broken; nothing is decompressed: a text chunk that is compressed or coded goes
whole, and becomes a `tEXt` chunk of the same length with a comment of spaces.
"""

import zlib

from app.photos import xmp
from app.photos.byte_file import Data, Edits
from app.photos.layout import Layout, Part, damage_recorded, truncated, unreadable

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 13
MAX_LENGTH = 0x7FFFFFFF  # the standard's limit
PIXELS = frozenset({b"PLTE", b"IDAT"})  # decoders need them unaltered
ANIMATION = frozenset({b"acTL", b"fcTL", b"fdAT"})  # APNG: each frame is another picture to decode
XMP_KEYWORD = b"XML:com.adobe.xmp"
PROFILE_PREFIX = b"raw profile type "  # ImageMagick's, in hexadecimal digits
PLACE_PROFILES = frozenset({b"exif", b"xmp", b"app1", b"iptc", b"8bim"})
COMMENT = b"tEXtComment\0"


def read_png_layout(data: Data) -> Layout:
    """Walk the chunks to IEND. The file begins with the signature."""
    layout = Layout(len(SIGNATURE))
    with damage_recorded(layout):
        _walk(data, layout)
    return layout


def _walk(data: Data, layout: Layout) -> None:
    has_pixels = False
    while True:
        start = layout.end + 8
        if start > len(data):
            raise truncated("the PNG's end chunk is missing")
        length, kind = int.from_bytes(data[start - 8 : start - 4]), data[start - 4 : start]
        chunk = Part(kind, start, start + length)
        if length > MAX_LENGTH or not kind.isalpha():
            raise unreadable("there is no PNG chunk where one must stand")
        if chunk.end + 4 > len(data):
            raise truncated("a PNG chunk is cut")
        if not layout.parts:
            layout.width, layout.height = _size(data, chunk)
        elif kind in ANIMATION:
            raise unreadable("the PNG is animated")
        elif kind in PIXELS and not _fits_checksum(data, chunk):
            raise unreadable("a part of the PNG's pixels does not fit its checksum")
        layout.parts.append(chunk)
        layout.end = chunk.end + 4
        has_pixels = has_pixels or (kind == b"IDAT" and length > 0)
        if kind == b"IEND":
            if not has_pixels:
                raise unreadable("the PNG has no picture before its end chunk")
            return


def renew_checksum(edits: Edits, chunk: Part) -> None:
    """Make the chunk's checksum fit its edited type and data."""
    edits.write(
        [(chunk.end, chunk.end + 4)], _checksum(edits.data, chunk.start, chunk.end).to_bytes(4)
    )


def _size(data: Data, header: Part) -> tuple[int, int]:
    """Width and height, px, in the file's first chunk."""
    start = header.start
    if (
        header.kind != b"IHDR"
        or header.end - start != HEADER_BYTES
        or not _fits_checksum(data, header)
    ):
        raise unreadable("the PNG's header is broken")
    size = int.from_bytes(data[start : start + 4]), int.from_bytes(data[start + 4 : start + 8])
    if 0 in size:
        raise unreadable("the PNG's header gives no size")
    return size


def _checksum(data: Data, start: int, end: int) -> int:
    """The checksum of a chunk's type and data."""
    return zlib.crc32(data[start - 4 : end])


def _fits_checksum(data: Data, chunk: Part) -> bool:
    return _checksum(data, chunk.start, chunk.end) == int.from_bytes(
        data[chunk.end : chunk.end + 4]
    )


def text_without_places(chunk: bytes) -> bytes:
    """A text chunk, type and data, as long as before, without what tells a place."""
    keyword, _, rest = chunk[4:].partition(b"\0")
    if holds_xmp(chunk):
        is_plain = chunk[:4] == b"iTXt" and rest[:1] == b"\0"
        parts = rest[2:].split(b"\0", 2)  # language, translated keyword, text
        if not is_plain or len(parts) < 3:
            return emptied_text(len(chunk))
        return chunk[: len(chunk) - len(parts[2])] + xmp.without_places(parts[2])
    return emptied_text(len(chunk)) if _tells_place(keyword) else chunk


def holds_xmp(chunk: bytes) -> bool:
    """Whether a text chunk, type and data, is an XMP packet."""
    return chunk[4:].startswith(XMP_KEYWORD + b"\0")


def emptied_text(length: int) -> bytes:
    """A `tEXt` chunk of this length, type and data, with nothing in it."""
    return COMMENT.ljust(length)[:length]


def _tells_place(keyword: bytes) -> bool:
    lower = keyword.lower()
    if lower.startswith(PROFILE_PREFIX):
        return lower.removeprefix(PROFILE_PREFIX) in PLACE_PROFILES
    return xmp.PLACE_NAME.fullmatch(keyword.rpartition(b":")[2]) is not None
