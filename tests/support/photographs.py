"""Small photographs for tests, made on the spot: noise, so that every one has other bytes."""

import io

import numpy as np
from PIL import Image


def photograph(seed=0, size=(640, 480), kind="JPEG", mode="RGB", **save):
    """An encoded photograph of this size (width, height)."""
    pixels = np.random.default_rng(seed).integers(0, 256, (size[1] // 8, size[0] // 8, 3), np.uint8)
    image = Image.fromarray(pixels).resize(size).convert(mode)
    buffer = io.BytesIO()
    image.save(buffer, kind, **save)
    return buffer.getvalue()


def pair(seed=0, **options):
    """A left and a right photograph, by slot."""
    return {"left": photograph(2 * seed, **options), "right": photograph(2 * seed + 1, **options)}


def with_hole(jpeg, at=0.5, lost=4000):
    """A JPEG that lost so many bytes of its picture on the way; it has its beginning and its end."""
    start = int(at * len(jpeg))
    return jpeg[:start] + jpeg[start + lost :]
