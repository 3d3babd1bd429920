"""Photographs for the phones of these tests: small JPEGs with a note of what their estimate shall be.

The note stands in a JPEG comment, which nothing cuts; the child reads it (stub_tasks.py), the checker computes the same
volumes from the same bytes, so that a record of another meal's pictures would be seen.
"""

import hashlib
import io
import json
from dataclasses import asdict, dataclass

import numpy as np
from PIL import Image

MARK = b"tada-fault-note:"
SIZE = (640, 480)


@dataclass(frozen=True)
class Note:
    """seconds: that the estimate takes. items: that it finds. crashes: the decoder dies of it."""

    seconds: float
    items: int = 1
    crashes: bool = False


def photograph(rng, note):
    """A JPEG of its own bytes: noise by the generator, and the note."""
    pixels = np.frombuffer(rng.randbytes(40 * 30 * 3), np.uint8).reshape(30, 40, 3)
    buffer = io.BytesIO()
    comment = MARK + json.dumps(asdict(note)).encode() + b"\n"
    Image.fromarray(pixels).resize(SIZE).save(buffer, "JPEG", quality=90, comment=comment)
    return buffer.getvalue()


def note_of(content):
    """What a picture says of itself, or None."""
    start = content.find(MARK)
    if start < 0:
        return None
    return Note(**json.loads(content[start + len(MARK) : content.index(b"\n", start)]))


def volumes_ml(left, right, items):
    """What the estimate of this very pair finds."""
    digest = hashlib.sha256(left + right).digest()
    return [round(50.0 + int.from_bytes(digest[4 * i : 4 * i + 3]) / 2**24 * 400.0, 3) for i in range(items)]
