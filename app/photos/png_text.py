"""PNG's text chunks: XMP in plain text is cleaned; what is compressed or coded is never unpacked, it goes whole.

A chunk that goes whole becomes a `tEXt` chunk of the same length with a comment of spaces.
"""

from app.photos import xmp

XMP_KEYWORD = b"XML:com.adobe.xmp"
PROFILE_PREFIX = b"raw profile type "  # ImageMagick's, in hexadecimal digits
PLACE_PROFILES = frozenset({b"exif", b"xmp", b"app1", b"iptc", b"8bim"})
COMMENT = b"tEXtComment\0"


def without_places(chunk: bytes) -> bytes:
    """A text chunk, type and data, as long as before, without what tells a place."""
    kind = chunk[:4]
    keyword, _, rest = chunk[4:].partition(b"\0")
    if holds_xmp(chunk):
        is_plain = kind == b"iTXt" and rest[:1] == b"\0"
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
