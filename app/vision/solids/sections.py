"""Horizontal sections of a closed mesh: the paper's slices (section V), cut from a fitted form.

Vertices and faces -> slices with their area's ellipse.
"""

import numpy as np

from app.vision.geometry.mesh import IntArray
from app.vision.geometry.slices import Slice, slice_thickness_mm
from app.vision.model import Float64Array


def cut_sections(vertices: Float64Array, faces: IntArray, support_mm: float) -> tuple[Slice, ...]:
    """Slices from the support upwards. Each has its section's area and the axes' ratio of its second moments."""
    height = float(vertices[:, 2].max()) - support_mm
    thickness = slice_thickness_mm(height)
    lows = np.arange(0.0, height, thickness)
    slices = []
    for low in lows:
        high = min(low + thickness, height)
        start, end = _segments(vertices, faces, support_mm + 0.5 * (low + high))
        if len(start) < 3:
            continue
        area = 0.5 * float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum())
        if area <= 0:
            continue
        length = np.linalg.norm(end - start, axis=1)
        middle = 0.5 * (start + end)
        centre = np.average(middle, axis=0, weights=length)
        spread, axes = np.linalg.eigh(np.cov((middle - centre).T, aweights=length))
        ratio = float(np.sqrt(spread[1] / max(spread[0], 1e-9)))
        half = float(np.sqrt(area / np.pi))
        slices.append(
            Slice(
                low_mm=float(low),
                high_mm=float(high),
                centre_mm=centre,
                half_axes_mm=(half * np.sqrt(ratio), half / np.sqrt(ratio)),
                heading=float(np.arctan2(axes[1, 1], axes[0, 1])),
                source="fitted",
            )
        )
    return tuple(slices)


def _segments(
    vertices: Float64Array, faces: IntArray, height_mm: float
) -> tuple[Float64Array, Float64Array]:
    """(k, 2), (k, 2) where the triangles cross a height, each with the inside to its left."""
    above = vertices[:, 2] > height_mm
    crossing = faces[above[faces].any(axis=1) & ~above[faces].all(axis=1)]
    start, end = [], []
    for corner in range(3):
        a, b, c = (crossing[:, (corner + shift) % 3] for shift in range(3))
        alone = above[a] != above[b]
        alone &= above[a] != above[c]
        a, b, c = a[alone], b[alone], c[alone]
        to_b, to_c = _crossing(vertices, a, b, height_mm), _crossing(vertices, a, c, height_mm)
        is_up = above[a][:, None]
        start.append(np.where(is_up, to_b, to_c))
        end.append(np.where(is_up, to_c, to_b))
    return np.concatenate(start), np.concatenate(end)


def _crossing(vertices: Float64Array, a: IntArray, b: IntArray, height_mm: float) -> Float64Array:
    share = (height_mm - vertices[a, 2]) / (vertices[b, 2] - vertices[a, 2])
    return np.asarray(
        vertices[a, :2] + share[:, None] * (vertices[b, :2] - vertices[a, :2]), np.float64
    )
