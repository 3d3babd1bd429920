"""Read the header of an uploaded depth or confidence map: PNG or TIFF, size, bits. path -> facts.

A depth map has one channel: a PNG of 16 bits or a TIFF of 32 bit floating point numbers. A confidence map is a PNG of 8
bits. Pixels are decoded later, in a child process (photograph/depth_map.py), and never more than the header states.
"""

from pathlib import Path

from app.core.errors import Failure
from app.photos.byte_file import Data
from app.photos.inspect import PNG, PhotoFacts
from app.photos.png import SIGNATURE, read_png_layout
from app.photos.tiff import byte_order, read_directories, read_numbers

TIFF = "image/tiff"
MAX_MAP_PIXELS = 8_000_000  # a phone's sensor has 0.05, structured light 2 million
# TIFF's tags
WIDTH, HEIGHT, BITS, ORIENTATION, CHANNELS, NUMBERS = 0x100, 0x101, 0x102, 0x112, 0x115, 0x153
FLOATING_POINT = 3  # of TIFF's SampleFormat
GREY = 0  # PNG's colour type
DEPTH_ADVICE = "Send a 16 bit grey PNG (0: not measured) or a TIFF of float32 in mm."
CONFIDENCE_ADVICE = "Send an 8 bit grey PNG of the depth map's size."


def inspect_depth(path: Path, *, is_confidence: bool = False) -> PhotoFacts | Failure:
    """The facts of the map at `path`. Failure: depth_unreadable. Raises OSError if the file cannot be read."""
    data = path.read_bytes()
    read = _read_png(data, 8 if is_confidence else 16) if data[:8] == SIGNATURE else None
    if read is None and not is_confidence:
        read = _read_tiff(data)
    if read is None:
        advice = CONFIDENCE_ADVICE if is_confidence else DEPTH_ADVICE
        return Failure("depth_unreadable", "The file is no such map, or it is damaged.", advice)
    return read


def _read_png(data: Data, bits: int) -> PhotoFacts | None:
    layout = read_png_layout(data)
    if layout.damage is not None:
        return None
    start = layout.parts[0].start
    if (data[start + 8], data[start + 9]) != (bits, GREY):
        return None
    return _facts(PNG, layout.width, layout.height)


def _read_tiff(data: Data) -> PhotoFacts | None:
    order, block = byte_order(data[:4]), bytes(data)
    directories = read_directories(block) if order is not None else None
    if order is None or not directories:
        return None
    entries = directories[0].entries
    stated = {entry.tag: read_numbers(block, entry, order) for entry in entries}
    # a decoder may take the other of two
    if len(stated) < len(entries) or stated.get(ORIENTATION, [1]) != [1]:
        return None
    if (
        stated.get(BITS) != [32]
        or stated.get(NUMBERS) != [FLOATING_POINT]
        or stated.get(CHANNELS, [1]) != [1]
    ):
        return None
    size = [stated.get(tag, []) for tag in (WIDTH, HEIGHT)]
    if [len(numbers) for numbers in size] != [1, 1]:
        return None
    return _facts(TIFF, int(size[0][0]), int(size[1][0]))


def _facts(media_type: str, width: int, height: int) -> PhotoFacts | None:
    if width * height == 0:
        return None
    return PhotoFacts(media_type, width, height, orientation=1, pixels_to_decode=width * height)
