"""Locations in what a photograph's file carries beside its picture, found by their marks. edits, start, end -> edits.

For parts whose structure is a maker's own: previews, secondary pictures after a JPEG's end (MPF, gain maps), appended
videos (motion photos), Samsung's trailer, boxes beside a HEIC's `meta`, content credentials. EXIF, XMP and Photoshop
blocks with their usual marks are cleaned as in the main picture; a video's location atoms become zeros in a `free`
atom. Past the limit on blocks, what follows a mark in its part becomes zeros. Timed location tracks in a video's
samples have no common form and stay.
"""

import re
from collections.abc import Callable, Iterator

from app.photos.byte_file import Edits, Extent
from app.photos.gps import without_gps
from app.photos.iptc import resources_without_places
from app.photos.metadata import (
    EXTENDED_XMP_HEADER_BYTES,
    EXTENDED_XMP_MARK,
    PHOTOSHOP_MARK,
    XMP_MARK,
)
from app.photos.tiff import HEADERS
from app.photos.xmp import emptied_packet, without_places

MAX_SEGMENT_BYTES = 0xFFFF
MAX_PACKET_BYTES = 1 << 18  # of XMP without a frame that tells its length
MAX_ATOM_BYTES = 4096  # of a location atom: coordinates and a place's name
ISO6709_REACH_BYTES = 1 << 16  # from the key's name to its value in the same small box
MAX_SAMSUNG_BLOCKS = 64
MAX_TEXT_BYTES = 1 << 20  # of a Samsung block that is searched for words
ISO6709 = re.compile(
    rb"[+-]\d{2,6}(?:\.\d{1,12})?[+-]\d{3,7}(?:\.\d{1,12})?(?:[+-]\d{1,6}(?:\.\d{1,12})?)?/?"
)
# who tells a longitude tells a latitude
PLACE_WORDS = (b"latitude", b"Latitude", b"LATITUDE", b"GPSInfo")
# of JPEG segments: mark, header with it
CLEANERS: tuple[tuple[bytes, int, Callable[[bytes], bytes]], ...] = (
    (PHOTOSHOP_MARK, len(PHOTOSHOP_MARK), resources_without_places),
    (XMP_MARK, len(XMP_MARK), without_places),
    # alone it is no XML
    (EXTENDED_XMP_MARK, EXTENDED_XMP_HEADER_BYTES, lambda part: emptied_packet(len(part))),
)
PACKET_START, PACKET_END = b"<x:xmpmeta", b"</x:xmpmeta>"


def clean_embedded(edits: Edits, start: int, end: int) -> None:
    """Take locations out of everything with a known mark between start and end."""
    for header in HEADERS:
        mark = b"Exif\0\0" + header
        for at in _marks(edits, mark, start, end):
            block = (
                at + 6,
                _segment_end(edits, at, start, end) or min(at + MAX_SEGMENT_BYTES, end),
            )
            edits.write([block], without_gps(edits.read([block])))
    for mark, header_bytes, clean in CLEANERS:
        for at in _marks(edits, mark, start, end):
            segment_end = _segment_end(edits, at, start, end)
            if segment_end and at + header_bytes < segment_end:
                block = (at + header_bytes, segment_end)
                edits.write([block], clean(edits.read([block])))
    _clean_bare_packets(edits, start, end)
    _clean_video_atoms(edits, start, end)


def clean_opaque(edits: Edits, start: int, end: int) -> None:
    """A block of unknown form: zeros if it speaks of coordinates, else cleaned by its marks."""
    clean_embedded(edits, start, end)
    if _speaks_of_place(edits, start, end):
        edits.blank(start, end)


def clean_samsung_trailer(edits: Edits, start: int, end: int) -> None:
    """Samsung's trailer: a directory (SEFH ... SEFT) at the end and its blocks; those with PLACE_WORDS become zeros."""
    data = edits.data
    if data[end - 4 : end] != b"SEFT" or end - 8 < start:
        return
    head = end - 8 - int.from_bytes(data[end - 8 : end - 4], "little")
    if head < start or data[head : head + 4] != b"SEFH":
        return
    count = min(int.from_bytes(data[head + 8 : head + 12], "little"), MAX_SAMSUNG_BLOCKS)
    for entry in range(head + 12, min(head + 12 + count * 12, end - 8 - 11), 12):
        block_start = head - int.from_bytes(data[entry + 4 : entry + 8], "little")
        block_end = block_start + int.from_bytes(data[entry + 8 : entry + 12], "little")
        if start <= block_start < block_end <= head and block_end - block_start <= MAX_TEXT_BYTES:
            name_end = (
                block_start + 8 + int.from_bytes(data[block_start + 4 : block_start + 8], "little")
            )
            if _speaks_of_place(edits, block_start, block_end) and name_end <= block_end:
                edits.blank(name_end, block_end)


def _speaks_of_place(edits: Edits, start: int, end: int) -> bool:
    return any(edits.data.find(word, start, end) >= 0 for word in PLACE_WORDS)


def _marks(edits: Edits, mark: bytes, start: int, end: int) -> Iterator[int]:
    """Where the mark stands; when the file has had too many blocks, zeros from there on."""
    at = edits.data.find(mark, start, end)
    while at >= 0:
        if not edits.may_clean_marked_block():
            edits.blank(at, end)
            return
        yield at
        at = edits.data.find(mark, at + len(mark), end)


def _segment_end(edits: Edits, at: int, start: int, end: int) -> int | None:
    """The end of the JPEG segment whose payload begins at `at`; None if there is no marker and length before it."""
    if at - 4 < start or edits.data[at - 4] != 0xFF:
        return None
    segment_end = at - 2 + int.from_bytes(edits.data[at - 2 : at])
    return min(segment_end, end) if segment_end > at + len(XMP_MARK) else None


def _clean_bare_packets(edits: Edits, start: int, end: int) -> None:
    """XMP by its own outer element, wherever it stands."""
    for at in _marks(edits, PACKET_START, start, end):
        found = edits.data.find(PACKET_END, at, min(at + MAX_PACKET_BYTES, end))
        if found >= 0:
            packet: Extent = (at, found + len(PACKET_END))
            edits.write([packet], without_places(edits.read([packet])))
        else:
            edits.blank(at, min(at + MAX_PACKET_BYTES, end))


def _clean_video_atoms(edits: Edits, start: int, end: int) -> None:
    data = edits.data
    for mark in (b"\xa9xyz", b"loci"):
        for at in _marks(edits, mark, start, end):
            atom_end = at - 4 + int.from_bytes(data[at - 4 : at]) if at - 4 >= start else 0
            if at + 4 < atom_end <= min(at + MAX_ATOM_BYTES, end):
                edits.write([(at, atom_end)], b"free".ljust(atom_end - at, b"\0"))
    for at in _marks(edits, b"location.ISO6709", start, end):
        near = data[at : min(at + ISO6709_REACH_BYTES, end)]
        for match in ISO6709.finditer(near):
            edits.write([(at + match.start(), at + match.end())], b" " * len(match[0]))
