"""The depth map beside a HEIC's photograph, as an iPhone writes it. bytes -> facts.

The map is an auxiliary image of 8 bits; its XMP says which numbers the levels stand for: disparity in 1/m or depth in
m, measured (absolute) or only right up to scale and offset (relative). Mattes and gain maps are no depth. Pixels are
decoded later, in a child process (vision/photograph/heic_depth.py).
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from app.core.errors import Failure
from app.photos.byte_file import Data, Extent, length_of, read_extents
from app.photos.depth import MAX_MAP_PIXELS
from app.photos.heif import HeifAuxiliary, HeifLayout

DEPTH_URNS = frozenset(
    {b"urn:mpeg:hevc:2015:auxid:2", b"urn:mpeg:mpegB:cicp:systems:auxiliary:depth"}
)
MAX_PACKET_BYTES = 1_000_000  # the lens's tables are in it; 10,000 are usual
MAX_SHAPE_ERROR = 0.02  # by which map and photograph may differ in width over height: the map shows the same picture
LARGEST = 1e4  # of a map's numbers, m or 1/m
FORMATS = {
    int.from_bytes(name): name for name in (b"hdis", b"fdis", b"hdep", b"fdep")
}  # CVPixelBuffer.h
VALUE = rb"[:\s]%s\s*(?:>|=\s*[\"'])\s*([^<\"']{1,64})"  # of an element or an attribute, under any prefix


@dataclass(frozen=True, slots=True)
class HeicDepth:
    """A depth map's levels: level_range stand for value_range, evenly between.

    is_inverse: the values are disparity, 1/m, else depth, m. is_metric: they are measured; else right up to scale and
    offset. width, height: as it is decoded. orientation: EXIF's, to be applied to what is decoded.
    """

    width: int
    height: int
    orientation: int
    level_range: tuple[float, float]
    value_range: tuple[float, float]
    is_inverse: bool
    is_metric: bool


def read_heic_depth(data: Data, layout: HeifLayout) -> HeicDepth | Failure | None:
    """The depth map beside the photograph; None if there is none. Failure "depth_unreadable" of one of no use."""
    maps = [each for each in layout.auxiliaries if each.urn in DEPTH_URNS]
    if not maps or layout.damage is not None:
        return None
    if len(maps) > 1:
        return _unreadable("it holds several")
    [auxiliary] = maps
    if not 0 < auxiliary.width * auxiliary.height <= auxiliary.pixels_to_decode <= MAX_MAP_PIXELS:
        return _unreadable(f"it has {auxiliary.width} x {auxiliary.height} px")
    packet = _packet(data, auxiliary.packets)
    native = _number(packet, b"NativeFormat")
    numbers = [
        _number(packet, key)
        for key in (b"IntMinValue", b"IntMaxValue", b"FloatMinValue", b"FloatMaxValue")
    ]
    if native is not None and int(native) not in FORMATS:
        return None  # a matte that calls itself depth: its format is grey
    if native is None or None in numbers:
        return _unreadable("its metadata do not define its levels")
    low_level, high_level, low, high = (number for number in numbers if number is not None)
    if not (0 <= low_level < high_level <= 255 and -LARGEST <= low < high <= LARGEST):
        return _unreadable("its levels stand for no range of numbers")
    orientation = _missing_turn(auxiliary, layout)
    if orientation is None:
        return _unreadable(
            "it is turned otherwise than the photograph, or shows another part of the scene"
        )
    accuracy = re.search(VALUE % b"Accuracy", packet)
    return HeicDepth(
        auxiliary.width,
        auxiliary.height,
        orientation,
        (low_level, high_level),
        (low, high),
        is_inverse=FORMATS[int(native)].endswith(b"dis"),
        is_metric=accuracy is not None and accuracy[1].strip() == b"absolute",
    )


def _packet(data: Data, places: Sequence[Sequence[Extent]]) -> bytes:
    """The first packet that describes pixels; empty if there is none."""
    packets = (
        read_extents(data, place) for place in places if length_of(place) <= MAX_PACKET_BYTES
    )
    return next((packet for packet in packets if b"NativeFormat" in packet), b"")


def _number(packet: bytes, key: bytes) -> float | None:
    match = re.search(VALUE % key, packet)
    try:
        number = float(match[1]) if match is not None else math.nan
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _missing_turn(auxiliary: HeifAuxiliary, layout: HeifLayout) -> int | None:
    """The orientation that the map still needs when its own is applied; None if it is not the photograph's."""
    size = auxiliary.width, auxiliary.height
    upright = (
        (layout.width, layout.height) if layout.orientation <= 4 else (layout.height, layout.width)
    )
    if auxiliary.orientation == layout.orientation:
        orientation = 1
    elif auxiliary.orientation == 1:
        orientation = layout.orientation
        size = size if orientation <= 4 else size[::-1]
    else:
        return None
    shape_error = abs(size[0] * upright[1] / (size[1] * upright[0]) - 1.0)
    return orientation if shape_error <= MAX_SHAPE_ERROR else None


def _unreadable(reason: str) -> Failure:
    return Failure(
        "depth_unreadable",
        f"The depth map in the HEIC file cannot be used: {reason}.",
        "Send the file as the camera saved it.",
    )
