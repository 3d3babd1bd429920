"""Small depth and confidence maps for tests: a slanted table, and the camera of it."""

import cv2
import numpy as np

CAMERA = {"width": 64, "height": 48, "fx": 61.0, "fy": 61.0, "cx": 31.5, "cy": 23.5, "unit_mm": 0.1}


def table_mm(seed=0, size=(64, 48)):
    """Depth of a plane from 400 to 600 mm, with half a per cent of noise. size: width, height."""
    rows = np.linspace(1 / 600, 1 / 400, size[1])[:, None]
    return np.repeat(1 / rows, size[0], axis=1) * (1 + 0.005 * np.random.default_rng(seed).standard_normal(size[::-1]))


def depth_png(seed=0, size=(64, 48), depth_mm=None):
    """16 bits in 0.1 mm."""
    depth_mm = table_mm(seed, size) if depth_mm is None else depth_mm
    return png(np.rint(depth_mm * 10).astype(np.uint16))


def depth_tiff(seed=0):
    """float32 in mm."""
    return cv2.imencode(".tiff", table_mm(seed).astype(np.float32))[1].tobytes()


def png(pixels):
    """Any picture as PNG."""
    return cv2.imencode(".png", pixels)[1].tobytes()


def confidence_png(level=2, size=(64, 48)):
    """The same level everywhere."""
    return png(np.full(size[::-1], level, np.uint8))
