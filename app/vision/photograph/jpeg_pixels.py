"""Whether a JPEG's entropy-coded data give all of its pixels: decoders fill a hole with grey and say nothing."""

import re

import simplejpeg

LOST = re.compile("premature end|bad huffman code", re.IGNORECASE)  # in libjpeg's warnings
TOO_MANY = re.compile(r"(\d+) extraneous bytes")
# some encoders fill up a block; more are the rest of a scan whose header is lost
MOST_PADDING_BYTES = 1024


def lacks_pixels(data: bytes) -> bool:
    """Whether part of the picture is lost, most likely because bytes were lost on the way.

    Every coefficient is decoded, to an eighth of the size, which takes a third to a half of the time of decoding in
    full. What libjpeg cannot decode for another reason is left to the decoder, whose words are more exact.
    """
    try:
        simplejpeg.decode_jpeg(data, "GRAY", min_height=1, min_width=1, min_factor=8, strict=True)
    except ValueError as error:
        words = str(error)
        padding = TOO_MANY.search(words)
        return bool(LOST.search(words)) or (
            padding is not None and int(padding[1]) > MOST_PADDING_BYTES
        )
    return False
