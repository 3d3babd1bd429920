"""Horizontal slices of a food (paper, section IV.F), and closed shapes of them or of a turned solid.

Circles and ellipses at their heights -> triangles that enclose the same volume.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from app.core.units import ml_from_mm3
from app.vision.geometry.mesh import ClosedShape, IntArray
from app.vision.model import Float64Array

SLICES = 32  # over the food's height, so that a step of a sphere's outline is a few percent of its radius
MIN_THICKNESS_MM = 1.0  # thinner, depth noise moves points between slices
CORNERS = 48  # of a ring: a corner of a food of 100 mm lies within a quarter of a millimetre of its ellipse
SAME_MM = 1e-6  # heights that are one
LEAST_RADIUS_MM = 0.1
VAULT_RINGS = 8
DEEPEST_SHARE = 0.95  # of the depth, that a hollow top may reach down

Source = Literal["fitted", "scaled", "mirrored", "continued"]


@dataclass(frozen=True, slots=True)
class Slice:
    """One slice: its place, form and where the form comes from.

    low_mm, high_mm: heights over the support. half_axes_mm: long, short. heading: of the long one. residual: relative
    sd of the outline's radii about the form. source: "fitted" to its own outline, "scaled" from the food's common
    shape, "mirrored" from above the widest slice, "continued" from the nearest.
    """

    low_mm: float
    high_mm: float
    centre_mm: Float64Array
    half_axes_mm: tuple[float, float]
    heading: float = 0.0
    residual: float = 0.0
    source: Source = "continued"

    @property
    def area_mm2(self) -> float:
        """Area of the circle or ellipse."""
        return float(np.pi * self.half_axes_mm[0] * self.half_axes_mm[1])

    @property
    def volume_ml(self) -> float:
        """V_k (eq. 15)."""
        return ml_from_mm3(self.area_mm2 * (self.high_mm - self.low_mm))


def disc(low_mm: float, high_mm: float, centre_mm: Float64Array, radius_mm: float) -> Slice:
    """A round slice that is not fitted to any points."""
    return Slice(low_mm, high_mm, centre_mm, (radius_mm, radius_mm))


def slice_thickness_mm(height_mm: float) -> float:
    """Thickness for a food of this height over the support."""
    return max(MIN_THICKNESS_MM, height_mm / SLICES)


def stack_of_slices(slices: Sequence[Slice]) -> ClosedShape:
    """One disc on the other, as their volumes are summed (paper, eq. 15). z from the support.

    Where carving took a slice out, a stack ends and another one begins above the gap.
    """
    stacks: list[list[Slice]] = []
    for layer in sorted(slices, key=lambda layer: layer.low_mm):
        if not stacks or layer.low_mm > stacks[-1][-1].high_mm + SAME_MM:
            stacks.append([])
        stacks[-1].append(layer)
    shapes = [
        _closed([ring for layer in stack for ring in (_ring(layer, 0), _ring(layer, 1))])
        for stack in stacks
    ]
    starts = np.cumsum([0, *(len(shape.vertices_mm) for shape in shapes)])
    return ClosedShape(
        np.concatenate([np.empty((0, 3)), *(shape.vertices_mm for shape in shapes)]),
        np.concatenate(
            [
                np.empty((0, 3), np.int64),
                *(shape.faces + start for shape, start in zip(shapes, starts[:-1], strict=True)),
            ]
        ),
    )


def turned(
    centre_mm: Float64Array, radii_mm: Float64Array, heights_mm: Float64Array, heap_mm: float
) -> ClosedShape:
    """A turned solid with a vault on it, or a hollow in it, of this mean height: a paraboloid, flat in the middle.

    centre_mm: (2,) of its axis. radii_mm, heights_mm: (n,) from below. A hollow ends above the lowest height.
    """
    rings = [_circle(centre_mm, radius, z) for radius, z in zip(radii_mm, heights_mm, strict=True)]
    depth, radius, level = heights_mm[-1] - heights_mm[0], float(radii_mm[-1]), heights_mm[-1]
    rise = max(2.0 * heap_mm, -DEEPEST_SHARE * depth)  # of a paraboloid's middle: twice its mean
    shares = np.linspace(1.0, 0.0, VAULT_RINGS + 1)[1:-1]
    rings += [
        _circle(centre_mm, share * radius, level + rise * (1.0 - share**2)) for share in shares
    ]
    shape = _closed(rings)
    shape.vertices_mm[-1, 2] = level + rise
    return shape


def _ring(layer: Slice, end: int) -> Float64Array:
    """(CORNERS, 3) of an ellipse at the slice's lower (0) or upper (1) end, at even directions about its centre."""
    direction = np.arange(CORNERS) * (2 * np.pi / CORNERS)
    along, across = np.cos(direction - layer.heading), np.sin(direction - layer.heading)
    long, short = layer.half_axes_mm
    radius = 1.0 / np.hypot(along / long, across / short)
    offsets = radius[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    after = np.roll(offsets, -1, axis=0)
    area = 0.5 * float((offsets[:, 0] * after[:, 1] - offsets[:, 1] * after[:, 0]).sum())
    offsets *= np.sqrt(layer.area_mm2 / area)  # so that the corners enclose what the ellipse does
    z = layer.high_mm if end else layer.low_mm
    return np.column_stack([layer.centre_mm + offsets, np.full(CORNERS, z)])


def _circle(centre_mm: Float64Array, radius_mm: float, z: float) -> Float64Array:
    return _ring(disc(z, z, centre_mm, max(float(radius_mm), LEAST_RADIUS_MM)), 0)


def _closed(rings: Sequence[Float64Array]) -> ClosedShape:
    """Rings joined one to the next, the first and the last closed by a fan about their middle."""
    count = len(rings)
    vertices = np.concatenate([*rings, rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    corners = np.arange(CORNERS)
    following = (corners + 1) % CORNERS
    low = (np.arange(count - 1) * CORNERS)[:, None]
    a, b = (low + corners).ravel(), (low + following).ravel()
    sides: IntArray = np.concatenate(
        [np.column_stack([a, b, b + CORNERS]), np.column_stack([a, b + CORNERS, a + CORNERS])]
    )
    top, bottom, roof = (count - 1) * CORNERS, count * CORNERS, count * CORNERS + 1
    fans = [
        np.column_stack([following, corners, np.full(CORNERS, bottom)]),
        np.column_stack([top + corners, top + following, np.full(CORNERS, roof)]),
    ]
    return ClosedShape(vertices, np.concatenate([sides, *fans]).astype(np.int64))
