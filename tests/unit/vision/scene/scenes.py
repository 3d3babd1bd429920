"""Scenes of known heights and colours on a plain grid of pixels."""

import numpy as np

from app.vision.scene.scene import Scene


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def slanting_rays(shape, focal_px):
    """(h, w, 3) directions of a camera that looks at the origin from a slant of 45 degrees."""
    rows, columns = np.indices(shape)
    u, v = (columns - shape[1] / 2) / focal_px, (rows - shape[0] / 2) / focal_px
    forward, down, right = np.array([0, 1, -1]) / np.sqrt(2), np.array([0, -1, -1]) / np.sqrt(2), np.array([1, 0, 0])
    return forward + u[..., None] * right + v[..., None] * down


def plain_scene(shape, **fields) -> Scene:
    """A grey scene of this shape seen from above, a millimetre a pixel, nothing measured, but for these fields."""
    rows, columns = np.indices(shape)
    nothing = np.full(shape, np.nan, np.float32)
    values = {
        "image_bgr": np.full((*shape, 3), 200, np.uint8),
        "height_mm": nothing,
        "points_table": np.dstack([nothing] * 3),
        "reach_px": np.full(shape, 2.0, np.float32),
        "is_ignored": np.zeros(shape, np.bool_),
        "plane_xy_mm": np.stack([columns, rows], -1).astype(np.float32),
        "camera_mm": np.array([0.0, 0.0, 500.0]),
        "pixel_mm": 1.0,
        "texture": np.zeros(shape, np.float32),
        "table_correlation": nothing,
    }
    return Scene(**values | fields)
