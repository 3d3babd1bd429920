"""Whether a PNG's data give all of its pixels: Pillow leaves rows that are missing black and says nothing."""

import zlib
from collections.abc import Iterator

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type (ISO/IEC 15948, table 11.1)
WHOLE = ((0, 0, 1, 1),)  # first column and row, and the steps to the next ones
ADAM7 = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)


def lacks_pixels(data: bytes) -> bool:
    """Whether rows are missing. The file begins with the signature and the header."""
    width, height = int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    bits = data[24] * CHANNELS.get(data[25], 0)
    expected = 0
    for left, top, step_x, step_y in ADAM7 if data[28] else WHOLE:
        columns, rows = -(-(width - left) // step_x), -(-(height - top) // step_y)
        if columns > 0 and rows > 0:
            expected += rows * (1 + -(-columns * bits // 8))  # each row begins with its filter
    try:
        pixels = zlib.decompressobj().decompress(b"".join(_pixel_chunks(data)), expected)
    except zlib.error:  # left to the decoder
        return False
    return len(pixels) < expected


def _pixel_chunks(data: bytes) -> Iterator[bytes]:
    position = 8
    while position + 8 <= len(data):
        start, end = position + 8, position + 8 + int.from_bytes(data[position : position + 4])
        if data[position + 4 : start] == b"IDAT":
            yield data[start:end]
        position = end + 4
