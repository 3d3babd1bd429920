"""The layout of a JPEG file (ITU-T T.81, annex B): its segments, its size, and where its first picture ends.

The entropy-coded data are stepped over, not decoded: a scan ends at the first marker that is neither a stuffed zero nor
a restart. What follows the end mark (other pictures, a video, a maker's own records) is left to embedded.py.
"""

import re

from app.photos.byte_file import Data
from app.photos.layout import Layout, Part, damage_recorded, truncated, unreadable

SOI, EOI, SOS, TEM, COM = b"\xd8", b"\xd9", b"\xda", b"\x01", b"\xfe"  # markers, without their FF
APP0, APP1, APP2, APP13, APP14, APP15 = b"\xe0", b"\xe1", b"\xe2", b"\xed", b"\xee", b"\xef"
FRAME_MARKERS = frozenset(bytes([code]) for code in range(0xC0, 0xD0)) - {
    b"\xc4",
    b"\xc8",
    b"\xcc",
}  # no DHT, JPG, DAC
# markers without length
ALONE = frozenset({TEM, EOI, *(bytes([code]) for code in range(0xD0, 0xD8))})
FIRST_SEGMENT_MARKER = b"\xc0"  # below are TEM and codes that no encoder may write

# of a progressive picture; encoders write some ten, and each is a pass over all pixels
MAX_SCANS = 100
# scans x pixels: 20 scans of the largest photograph that is taken by default
MAX_SCAN_PIXELS = 1_200_000_000
FILL = re.compile(rb"\xff*+")
SCAN_END = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


def read_jpeg_layout(data: Data) -> Layout:
    """Walk the segments to the end mark of the file's first picture. The file begins with SOI."""
    layout = Layout(2, scans=0)
    with damage_recorded(layout):
        _walk(data, layout)
    return layout


def _walk(data: Data, layout: Layout) -> None:
    while True:
        segment = _segment_at(data, layout.end)
        layout.end = segment.end
        if segment.kind == EOI:
            if layout.scans == 0:
                raise unreadable("the JPEG has no picture before its end mark")
            return
        layout.parts.append(segment)
        if segment.kind in FRAME_MARKERS:
            if layout.width:
                raise unreadable("the JPEG has two frame headers")
            layout.width, layout.height = _frame_size(data, segment)
        elif segment.kind == SOS:
            layout.scans += 1
            _check_scan(layout)
            layout.end = _end_of_scan(data, layout.end)


def _check_scan(layout: Layout) -> None:
    """Raise what forbids the latest scan."""
    if layout.width == 0:
        raise unreadable("the JPEG's scan comes before its frame header")
    if layout.scans > MAX_SCANS:
        raise unreadable(f"the JPEG has more than {MAX_SCANS} scans")
    # A single scan is bounded by the pixels alone.
    if layout.scans > 1 and layout.scans * layout.width * layout.height > MAX_SCAN_PIXELS:
        raise unreadable("the JPEG has more scans than a photograph of its size may have")


def _segment_at(data: Data, position: int) -> Part:
    """The segment at `position`, perhaps after fill bytes; a marker that stands alone has no payload."""
    marker_at = _end_of_fill(data, position)
    if marker_at >= len(data):
        raise truncated("the JPEG's end mark is missing")
    marker = data[marker_at : marker_at + 1]
    if marker_at == position:
        raise unreadable("there is no JPEG marker where one must stand")
    if marker in ALONE:
        return Part(marker, marker_at + 1, marker_at + 1)
    if marker < FIRST_SEGMENT_MARKER or marker == SOI:
        raise unreadable(f"a JPEG marker FF{marker.hex().upper()} stands where none may")
    start, end = marker_at + 3, marker_at + 1 + int.from_bytes(data[marker_at + 1 : marker_at + 3])
    if max(start, end) > len(data):
        raise truncated("a JPEG segment is cut")
    if start > end:
        raise unreadable("a JPEG segment has an impossible length")
    return Part(marker, start, end)


def _frame_size(data: Data, segment: Part) -> tuple[int, int]:
    """Width and height. A height of 0 would come in a later DNL segment, which decoders do not read."""
    start = segment.start
    height, width = (
        int.from_bytes(data[start + 1 : start + 3]),
        int.from_bytes(data[start + 3 : start + 5]),
    )
    if segment.end - start < 6 or not (width and height):
        raise unreadable("the JPEG's frame header gives no size")
    return width, height


def _end_of_fill(data: Data, position: int) -> int:
    """Past the FF bytes: any number of them may precede a marker's code."""
    match = FILL.match(data, position)
    return match.end() if match else position


def _end_of_scan(data: Data, position: int) -> int:
    """Where the marker after the entropy-coded data stands, or the file's end."""
    match = SCAN_END.search(data, position)
    return match.start() if match else len(data)
