"""Families with flat tops and edges: blocks on four corners, wedges on three, with walls, a top and rounded edges.

What a mould, a knife or a carton machine leaves is flat to a few per cent. Those per cent are the weights: a draught of
the walls, a lean, a slope and a crown of the top, bulging sides, and corners that are not quite square; and a smooth
displacement of walls and top for dents, crusts and what else is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from app.vision.geometry.mesh import IntArray, Topology, stacked_loops, unit
from app.vision.model import Float64Array
from app.vision.solids.forms import COARSE, FINE, Form, harmonic_orders, real_harmonics

# Indices into a prism's parameters; lengths mm, of half-axes, height and rounding as logarithms. The footprint is a
# regular polygon of radius one, stretched by exp(A) and exp(B) along its axes, sheared by SKEW and turned by TURN.
X, Y, SUPPORT, A, B, HEIGHT, SKEW, TURN, ROUNDING = range(9)
STEP = np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2])  # of the finite differences
STRIDE = np.array([3.0, 3.0, 1.0, 0.15, 0.15, 0.15, 0.1, 0.15, 0.3])  # the most at one step

ROUNDING_MM, ROUNDING_LOG_SD = 1.5, 0.8  # an edge of card or a blade's cut to the edge of a loaf
LEAST_ROUNDING_MM = 0.1
MOST_ROUNDING = 0.4  # of the height and of the footprint's inscribed circle
SQUARE_SKEW_SD = 0.03  # of a block's corner, two degrees: a box, or a cut along another
FREE_SKEW_SD = 0.5  # of a wedge, whose corners may be any
# Of the weights, relative to the length that each changes.
DRAUGHT_SD, LEAN_SD, SLOPE_SD, CROWN_SD = 0.03, 0.03, 0.03, 0.03
KEYSTONE_SD = 0.02  # opposite sides that are not parallel, a block's
SIDE_SD = {
    3: 0.06,
    4: 0.015,
}  # a side's bulge over its length; a round cheese's rind has a tenth on its short side
DISPLACEMENT_SD = 0.03  # in mean half-axes, over the degree
# degree one moves and tilts; finer ones would round off the edges
DISPLACEMENT_ORDERS = harmonic_orders(2, 4)
WALL_LOOPS = {COARSE: 2, FINE: 4}
CORNER_SPREAD = 0.6  # of a step along a side
TOP_SHARES = (0.8, 0.5, 0.2)  # of the loops within the top


@dataclass(frozen=True, slots=True)
class Prism(Form):
    """A right prism on `corners` corners, 3 or 4, that rests on its support; edges are the mesh's own.

    parameters: (9,), see the indices of this module.
    """

    parameter_stride: ClassVar[Float64Array] = STRIDE
    parameter_step: ClassVar[Float64Array] = STEP

    corners: int = 4

    @property
    def height_over_width(self) -> tuple[Mapping[int, float], float]:
        """See Form; the whole height over half the width."""
        return {HEIGHT: 1.0, A: -0.5, B: -0.5}, -float(np.log(2))

    @property
    def is_flat(self) -> bool:
        """It has."""
        return True

    @property
    def weight_sd(self) -> Float64Array:
        """Of draught, lean (2), slope of the top (2), crown, sides, a block's keystones (2), and the displacement."""
        sides = [SIDE_SD[self.corners]] * self.corners
        keystones = [KEYSTONE_SD] * 2 if self.corners == 4 else []
        displacement = [DISPLACEMENT_SD / degree for degree, _ in DISPLACEMENT_ORDERS]
        return np.array(
            [
                DRAUGHT_SD,
                LEAN_SD,
                LEAN_SD,
                SLOPE_SD,
                SLOPE_SD,
                CROWN_SD,
                *sides,
                *keystones,
                *displacement,
            ]
        )

    @property
    def parameter_sd(self) -> Float64Array:
        """Places, sizes and heading are free."""
        skew = SQUARE_SKEW_SD if self.corners == 4 else FREE_SKEW_SD
        return np.array(
            [np.inf, np.inf, 1.0, np.inf, np.inf, np.inf, skew, np.inf, ROUNDING_LOG_SD]
        )

    @property
    def expected(self) -> Float64Array:
        """See Form; a wedge that begins skewed is expected none the more so."""
        out = self.start
        out[self.free.index(SKEW)], out[self.free.index(ROUNDING)] = 0.0, np.log(ROUNDING_MM)
        return self._as_high_as_usual(out)

    def topology(self, cells: int) -> Topology:
        """Loops of the outline, one above the other."""
        layout = _layout(self.corners, cells)
        return stacked_loops(len(layout.loops), len(layout.corner))

    def shaped(self, p: Float64Array, weights: Float64Array, cells: int) -> Float64Array:
        """See Form."""
        layout, count, many = _layout(self.corners, cells), self.corners, len(p)
        weights = weights if weights.size else np.zeros((many, len(self.weight_sd)))
        draught, lean, slope, crown = (
            weights[:, 0, None, None],
            weights[:, 1:3],
            weights[:, 3:5],
            weights[:, 5, None],
        )
        sides, keystones = (
            weights[:, 6 : 6 + count],
            weights[:, 6 + count : -len(DISPLACEMENT_ORDERS)],
        )
        height = np.exp(p[:, HEIGHT, None])
        polygon = _footprint(p, keystones, count)
        normals, lengths = _sides(polygon)
        radius = _rounding_mm(p, polygon, normals)
        inner, spread, outward = _loop(polygon, normals, lengths, radius, sides, layout)
        inward, offset, by_rounding, by_height = layout.loops.T[:, :, None, None]
        plan = inward * (inner[:, None] + (1 - offset) * spread[:, None])
        plan += radius[:, None, None, None] * offset * outward[:, None]
        level = by_rounding.ravel() * radius[:, None] + by_height.ravel() * height
        plan = np.concatenate([plan.reshape(many, -1, 2), np.zeros((many, 2, 2))], axis=1)
        z = np.concatenate(
            [np.repeat(level, inner.shape[1], axis=1), np.zeros((many, 1)), height], axis=1
        )
        share = (z / height - 0.5)[:, :, None]
        size = np.sqrt(np.exp(p[:, A] + p[:, B]))[:, None]
        crowned = crown * (1 - (plan**2).sum(axis=2) / size**2)
        z = z * (1 + np.einsum("qnb,qb->qn", plan, slope) / size + crowned)
        plan = plan * (1 + draught * share) + height[:, :, None] * share * lean[:, None]
        at = np.concatenate(
            [plan + p[:, None, [X, Y]], (p[:, SUPPORT, None] + z)[:, :, None]], axis=2
        )
        moved = np.exp(p[:, [A, B, HEIGHT]].mean(axis=1))[:, None]
        moved = moved * (weights[:, -len(DISPLACEMENT_ORDERS) :] @ _harmonics(count, cells).T)
        across = moved[:, :-2].reshape(many, len(layout.loops), -1, 1) * offset * outward[:, None]
        at[:, :-2, :2] += across.reshape(many, -1, 2)
        at[:, :, 2] += moved * _upward(count, cells)
        return at


def prism(
    name: str, polygon_mm: Float64Array, height_mm: float, support_mm: float, support_sd_mm: float
) -> Prism:
    """The prism on a footprint of three corners, or the block on a rectangle's four, (n, 2), counter-clockwise."""
    middle = polygon_mm.mean(axis=0)
    reference = _reference(len(polygon_mm))
    numberings = []
    for first in range(len(polygon_mm)):
        matrix = np.linalg.lstsq(
            reference, np.roll(polygon_mm, -first, axis=0) - middle, rcond=None
        )[0].T
        turn = float(np.arctan2(matrix[1, 0], matrix[0, 0]))
        cosine, sine = np.cos(turn), np.sin(turn)
        shear, b = np.array([[cosine, sine], [-sine, cosine]]) @ matrix[:, 1]
        sizes = np.log([np.hypot(*matrix[:, 0]), b, height_mm])
        numberings.append(
            np.array([*middle, support_mm, *sizes, shear / b, turn, np.log(ROUNDING_MM)])
        )
    p = min(numberings, key=lambda each: abs(float(each[SKEW])))
    return Prism(name, p, tuple(range(len(p))), np.eye(3), support_sd_mm, corners=len(polygon_mm))


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where vertices lie on the undeformed prism.

    corner: (m,) the corner at or after which each vertex of a loop lies. along: (m,) its share of the way to the next
    corner. turned: (m,) the share of the corner's angle by which its normal has turned, 1 along sides. loops: (n, 4),
    from the base upwards: share of the way from the middle out, of the rounding outwards, and the level as multiples
    of the rounding and of the height.
    """

    corner: IntArray
    along: Float64Array
    turned: Float64Array
    spread: Float64Array
    loops: Float64Array


@lru_cache
def _layout(corners: int, cells: int) -> _Layout:
    arc, side, wall = (
        max(2, cells // 6 * 2),
        max(3, cells // 2),
        WALL_LOOPS.get(cells, WALL_LOOPS[FINE]),
    )
    along = np.concatenate([np.zeros(arc + 1), np.arange(1, side) / side])
    turned = np.concatenate([np.arange(arc + 1) / arc, np.ones(side - 1)])
    spread = np.concatenate(
        [(np.arange(arc + 1) / arc - 0.5) * CORNER_SPREAD / side, np.zeros(side - 1)]
    )
    angle = np.linspace(0, np.pi / 2, arc + 1)
    loops = [(1.0, np.sin(each), 1 - np.cos(each), 0.0) for each in angle]
    loops += [(1.0, 1.0, 1 - 2 * step / wall, step / wall) for step in range(1, wall + 1)]
    loops += [(1.0, np.cos(each), np.sin(each) - 1, 1.0) for each in angle[1:]]
    loops += [(share, 0.0, 0.0, 1.0) for share in TOP_SHARES]
    number = np.repeat(np.arange(corners), len(along))
    along, turned, spread = (np.tile(each, corners) for each in (along, turned, spread))
    return _Layout(number, along, turned, spread, np.array(loops))


@lru_cache
def _harmonics(corners: int, cells: int) -> Float64Array:
    """(n, len(DISPLACEMENT_ORDERS)) at the vertices of the prism whose sides are all as far from its middle."""
    layout, reference = _layout(corners, cells), _reference(corners)
    towards = np.roll(reference, -1, axis=0) - reference
    loop = reference[layout.corner] + layout.along[:, None] * towards[layout.corner]
    plan = np.concatenate(
        [(layout.loops[:, 0, None, None] * loop).reshape(-1, 2), np.zeros((2, 2))]
    )
    level = np.append(np.repeat(2 * layout.loops[:, 3] - 1, len(loop)), [-1.0, 1.0])
    return real_harmonics(unit(np.column_stack([plan, level])), DISPLACEMENT_ORDERS)


@lru_cache
def _upward(corners: int, cells: int) -> Float64Array:
    """(n,) the share of the displacement that raises a vertex: all on the top, none on walls and on the base."""
    layout = _layout(corners, cells)
    share = np.where(
        layout.loops[:, 3] == 1.0, np.sqrt(1 - np.minimum(layout.loops[:, 1], 1.0) ** 2), 0.0
    )
    return np.append(np.repeat(share, len(layout.corner)), [0.0, 1.0])


def _reference(corners: int) -> Float64Array:
    """(n, 2) corners at distance one from the middle; a square's sides run along the axes."""
    first = np.pi / 4 if corners == 4 else 0.0
    angle = first + 2 * np.pi * np.arange(corners) / corners
    scale = np.sqrt(2.0) if corners == 4 else 1.0
    return scale * np.column_stack([np.cos(angle), np.sin(angle)])


def _footprint(p: Float64Array, keystones: Float64Array, corners: int) -> Float64Array:
    """(q, n, 2) corners about the middle, mm. p: (q, 9). keystones: (q, 2) of a block."""
    u, v = _reference(corners).T
    if keystones.size:
        u, v = u * (1 + keystones[:, 0, None] * v), v * (1 + keystones[:, 1, None] * u)
    a, b, skew, turn = (p[:, each, None] for each in (A, B, SKEW, TURN))
    x, y = np.exp(a) * u + np.exp(b) * skew * v, np.exp(b) * v
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=2)


def _sides(polygon: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(q, n, 2) outward normals of the sides that begin at each corner, and (q, n) their lengths."""
    along = np.roll(polygon, -1, axis=1) - polygon
    lengths = np.linalg.norm(along, axis=2)
    return np.stack([along[:, :, 1], -along[:, :, 0]], axis=2) / lengths[:, :, None], lengths


def _rounding_mm(p: Float64Array, polygon: Float64Array, normals: Float64Array) -> Float64Array:
    """(q,) the edges' radius, bounded smoothly by what the prism is large enough for."""
    most = MOST_ROUNDING * np.minimum(
        np.exp(p[:, HEIGHT]), (polygon * normals).sum(axis=2).min(axis=1)
    )
    radius_mm = LEAST_ROUNDING_MM + np.exp(p[:, ROUNDING])
    return np.asarray(radius_mm * most / np.hypot(radius_mm, most), np.float64)


def _loop(
    polygon: Float64Array,
    normals: Float64Array,
    lengths: Float64Array,
    radius: Float64Array,
    sides: Float64Array,
    layout: _Layout,
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(q, m, 2) each: the footprint less the rounding, see _Layout.spread, and the directions of the rounding out."""
    before = np.roll(normals, 1, axis=1)
    cosine = (normals * before).sum(axis=2)
    corners = polygon - radius[:, None, None] * (normals + before) / (1 + cosine)[:, :, None]
    here, count = layout.corner, polygon.shape[1]
    towards = corners[:, (here + 1) % count] - corners[:, here]
    inner = corners[:, here] + layout.along[:, None] * towards
    back = corners[:, here] - corners[:, (here - 1) % count]
    spread = layout.spread[:, None] * np.where(layout.spread[:, None] < 0, back, towards)
    bulge = 4 * layout.along * (1 - layout.along) * sides[:, here] * lengths[:, here]
    start = np.arctan2(before[:, :, 1], before[:, :, 0])
    angle = start[:, here] + layout.turned * np.arccos(np.clip(cosine, -1, 1))[:, here]
    outward = np.stack([np.cos(angle), np.sin(angle)], axis=2)
    return inner + bulge[:, :, None] * normals[:, here], spread, outward
