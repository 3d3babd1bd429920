"""The layout of a JPEG file (ITU-T T.81, annex B): its segments, its size, and where its first picture ends.

The entropy-coded data are stepped over, not decoded: a scan ends at the first marker that is neither a stuffed zero nor
a restart. What follows the end mark (other pictures, a video, a maker's own records) is left to embedded.py.
"""

import re
from dataclasses import dataclass

from app.core.errors import Failure
from app.photos.byte_file import STEP_BYTES, Data
from app.photos.damage import truncated, unreadable

SOI, EOI, SOS, TEM, COM = 0xD8, 0xD9, 0xDA, 0x01, 0xFE
APP0, APP1, APP2, APP13, APP14, APP15 = 0xE0, 0xE1, 0xE2, 0xED, 0xEE, 0xEF
FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF0..15 without DHT, JPG and DAC
ALONE = frozenset({TEM, EOI, *range(0xD0, 0xD8)})  # markers without length
FIRST_SEGMENT_MARKER = 0xC0  # below are TEM and codes that no encoder may write

MAX_SEGMENTS = 10_000  # 60 MB of extended XMP take 1,000, a progressive picture some 100
MAX_SCANS = 100  # of a progressive picture; encoders write some ten, and each is a pass over all pixels
MAX_SCAN_PIXELS = 1_200_000_000  # scans x pixels: 20 scans of the largest photograph that is taken by default
TOO_MANY_SCANS_FOR_SIZE = "the JPEG has more scans than a photograph of its size may have"
TOO_MANY_SCANS = f"the JPEG has more than {MAX_SCANS} scans"
FILL = re.compile(rb"\xff*+")
SCAN_END = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


@dataclass(frozen=True, slots=True)
class JpegSegment:
    """A marker with its payload: start and end without marker and length."""

    marker: int
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class JpegLayout:
    """What was read, up to the end mark or the damage; `end` is the first byte that was not read."""

    segments: tuple[JpegSegment, ...]
    width: int
    height: int
    end: int
    damage: Failure | None
    scans: int


def read_jpeg_layout(data: Data) -> JpegLayout:
    """Walk the segments to the end mark of the file's first picture. The file begins with SOI."""
    segments: list[JpegSegment] = []
    size: tuple[int, int] | None = None
    scans = 0
    position = 2

    def layout(damage: Failure | None) -> JpegLayout:
        return JpegLayout(tuple(segments), *(size or (0, 0)), position, damage, scans)

    for _ in range(MAX_SEGMENTS):
        segment = _segment_at(data, position)
        if isinstance(segment, Failure):
            return layout(segment)
        position = segment.end
        if segment.marker == EOI:
            return layout(None if scans else unreadable("the JPEG has no picture before its end mark"))
        segments.append(segment)
        if segment.marker in FRAME_MARKERS:
            if size is not None:
                return layout(unreadable("the JPEG has two frame headers"))
            size = _frame_size(data, segment)
            if size is None:
                return layout(unreadable("the JPEG's frame header gives no size"))
        elif segment.marker == SOS:
            scans += 1
            if why := _why_not_scanned(size, scans):
                return layout(unreadable(why))
            position = _end_of_scan(data, position)
    return layout(unreadable(f"the JPEG has more than {MAX_SEGMENTS} segments"))


def _why_not_scanned(size: tuple[int, int] | None, scans: int) -> str | None:
    """What forbids the scan of this number, counted from 1; None if it may be."""
    if size is None:
        return "the JPEG's scan comes before its frame header"
    if scans > MAX_SCANS:
        return TOO_MANY_SCANS
    if scans > 1 and scans * size[0] * size[1] > MAX_SCAN_PIXELS:  # a single scan is bounded by the pixels alone
        return TOO_MANY_SCANS_FOR_SIZE
    return None


def _segment_at(data: Data, position: int) -> JpegSegment | Failure:
    """The segment at `position`, perhaps after fill bytes; a marker that stands alone has no payload."""
    marker_at = _end_of_fill(data, position)
    if marker_at >= len(data):
        return truncated("the JPEG's end mark is missing")
    marker = data[marker_at]
    if marker_at == position:
        return unreadable("there is no JPEG marker where one must stand")
    if marker in ALONE:
        return JpegSegment(marker, marker_at + 1, marker_at + 1)
    if marker < FIRST_SEGMENT_MARKER or marker == SOI:
        return unreadable(f"a JPEG marker FF{marker:02X} stands where none may")
    start, end = marker_at + 3, marker_at + 1 + int.from_bytes(data[marker_at + 1 : marker_at + 3])
    if max(start, end) > len(data):
        return truncated("a JPEG segment is cut")
    return JpegSegment(marker, start, end) if start <= end else unreadable("a JPEG segment has an impossible length")


def _frame_size(data: Data, segment: JpegSegment) -> tuple[int, int] | None:
    """Width and height; None if absent. A height of 0 would come in a later DNL segment, which decoders do not read."""
    start = segment.start
    if segment.end - start < 6:
        return None
    height, width = int.from_bytes(data[start + 1 : start + 3]), int.from_bytes(data[start + 3 : start + 5])
    return (width, height) if width and height else None


def _end_of_fill(data: Data, position: int) -> int:
    """Past the FF bytes: any number of them may precede a marker's code."""
    while (match := FILL.match(data, position, position + STEP_BYTES)) and match.end() == position + STEP_BYTES:
        position += STEP_BYTES
    return match.end() if match else position


def _end_of_scan(data: Data, position: int) -> int:
    """Where the marker after the entropy-coded data stands, or the file's end.

    In pieces, because a search in one go would hold up every other thread.
    """
    while position < len(data):
        match = SCAN_END.search(data, position, position + STEP_BYTES + 1)
        if match:
            return match.start()
        position += STEP_BYTES
    return len(data)
