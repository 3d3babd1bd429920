"""The families of form that a food may have, as closed surfaces with few parameters and a smooth rest.

A superellipsoid (Barr, 1981) that may taper, bend (Solina and Bajcsy, 1990) and be sunk into its support, so that a
heap has a flat foot; and a ring. Both rest on the support. A smooth displacement along the normals takes up what the
parameters cannot: spherical harmonics on the one, Fourier terms on the other, with spreads that fall with the degree.
Terms that are the same all round the form's axis are the freest: a food turned like a lathe's work shows on its
visible side what the hidden one is like (Thrun and Wegbreit, 2005).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import cv2
import numpy as np
from numpy.polynomial import Legendre

from app.vision.geometry.mesh import IntArray, Topology, ring, sphere
from app.vision.model import Float64Array
from app.vision.tuning import TUNING

COARSE, FINE, EXACT = 6, 8, 24  # cells a side of the cube: to find, to fit, to take the volume
DEGREE = 6  # of the spherical harmonics: features of a sixth of the circumference
# Of the displacement in mean radii at degree one, all round the axis or not.
LATHE_SD, REST_SD, HEAP_SD = 0.06, 0.03, 0.08
ROUND_SD = 0.04  # of a round section: the ratio of its half-axes, logarithm
ROUND_EXPONENT_SD = 0.15
RING_SD = 0.04
RING_WAVES = 3
DEGREE_ONE = 0.3  # of the spread that the degree would have
WEIGHT_STEP, WEIGHT_STRIDE = 1e-3, 0.05

# Indices into a form's parameters. Lengths mm, angles radians, exponents and half-axes as logarithms.
X, Y, SUPPORT, SUNK, A, B, C, E1, E2, TURN_X, TURN_Y, TURN_Z, TAPER, BEND = range(14)
STEP = np.full(14, 1e-3)  # of the finite differences
STEP[[X, Y, SUPPORT, SUNK]] = 0.05
# the most at one step
STRIDE = np.array([3, 3, 1, 3, 0.15, 0.15, 0.15, 0.3, 0.3, 0.15, 0.15, 0.15, 0.1, 0.2])
SPREAD = np.array(
    [np.inf, np.inf, 1, 20, np.inf, np.inf, np.inf, 0.35, 0.35, 0.5, 0.5, 0.5, 0.25, 0.5]
)  # prior
# What is wide and low rests on its flat side: it tilts by what its support and its own unevenness make of it. Wider,
# a ball whose outlines alone are seen would be flat along the line of sight.
STANDING, TILT_SD = ("ball", "slab", "ring"), 0.15
LYING = ("lying", "bent")  # whose axis C lies on the support
SUPPORT_BOUND = 2.0  # sd, within which the support stays
_PLACING = (X, Y, SUPPORT, TURN_X, TURN_Y, TURN_Z)
AT_FOOT = 1e-6  # of a unit direction's height: on the equator
LEAST_CUT = 0.98  # of half the height: the cut stays between both ends
# a box with rounded edges to a form pointed like a lemon
LOG_EXPONENTS = (np.log(0.1), np.log(1.5))


@dataclass(frozen=True, slots=True)
class Form(ABC):
    """A family with its start. Unknowns are a vector (k,): the free parameters, then weights of the displacement.

    parameters: (p,) start, see the indices above or those of the family's own module; X, Y and SUPPORT are the same in
    all. free: those that are fitted. support_sd_mm: spread of SUPPORT.
    axes: (3, 3) the form's own axes as columns, table frame. usual_height: mean and spread of the logarithm of its
    height over its width, for views that hardly tell them apart. is_round: whether its section across C is, as of what
    grows round a stalk; the side that nobody sees is as deep as the one that is seen is wide.
    """

    # (p,) the most that a parameter may change at one step, and what it is moved by for a difference
    parameter_stride: ClassVar[Float64Array] = STRIDE
    parameter_step: ClassVar[Float64Array] = STEP

    name: str
    parameters: Float64Array
    free: tuple[int, ...]
    axes: Float64Array
    support_sd_mm: float
    has_displacement: bool = True
    is_round: bool = False
    usual_height: tuple[float, float] | None = None

    @property
    def height_over_width(self) -> tuple[Mapping[int, float], float]:
        """The factors of parameters, and what is added, that make the logarithm of height over width.

        Width is the geometric mean of length and breadth. The height's own factor is 1, the only one over 0.
        """
        return {C: 1.0, A: -0.5, B: -0.5}, 0.0

    @property
    def is_flat(self) -> bool:
        """Whether it has long straight edges, at whose ends alone its mesh has vertices."""
        return False

    @property
    @abstractmethod
    def weight_sd(self) -> Float64Array:
        """Prior spread of the displacement's weights."""

    @abstractmethod
    def topology(self, cells: int) -> Topology:
        """The mesh at a resolution: COARSE, FINE or EXACT."""

    @abstractmethod
    def shaped(self, p: Float64Array, weights: Float64Array, cells: int) -> Float64Array:
        """(q, n, 3) vertices, mm, table frame, of (q, p) parameters and (q, w) weights, which may be none."""

    @property
    def start(self) -> Float64Array:
        """(k,) where fitting begins."""
        return np.concatenate([self.parameters[list(self.free)], np.zeros(len(self._weight_sd))])

    @property
    def expected(self) -> Float64Array:
        """(k,) the prior's middle; places and sizes have none of their own."""
        out = self.start
        if self.is_round:
            section = [self.free.index(A), self.free.index(B)]
            out[section] = out[section].mean()
        return self._as_high_as_usual(out)

    def _as_high_as_usual(self, unknowns: Float64Array) -> Float64Array:
        """(k,) the unknowns with the height that usual_height expects over their width."""
        if self.usual_height is None:
            return unknowns
        tie, added = self._height_tie
        out = unknowns.copy()
        out[tie.argmax()] += self.usual_height[0] - float(tie @ unknowns) - added
        return out

    @property
    def _height_tie(self) -> tuple[Float64Array, float]:
        """(k,) factors of the unknowns, and what is added; see height_over_width."""
        factors, added = self.height_over_width
        tie = np.zeros(len(self._prior_sd))
        for parameter, factor in factors.items():
            tie[self.free.index(parameter)] = factor
        return tie, added

    @property
    def prior_precision(self) -> Float64Array:
        """(k, k) inverse covariance of the prior; places and sizes are free, but for a round section's ratio."""
        out = np.diag(1.0 / self._prior_sd**2)
        if self.is_round:
            tie = np.zeros(len(out))
            tie[self.free.index(A)], tie[self.free.index(B)] = 1.0 / ROUND_SD, -1.0 / ROUND_SD
            out += np.outer(tie, tie)
        if self.usual_height is not None:
            tie, _ = self._height_tie
            out += np.outer(tie, tie) / self.usual_height[1] ** 2
        return out

    @property
    def prior_log_determinant(self) -> float:
        """Of prior_precision, over what is not free."""
        spread = self._prior_sd
        bound = -2 * float(np.log(spread[np.isfinite(spread)]).sum())
        bound -= 2 * float(np.log(ROUND_SD)) if self.is_round else 0.0
        return (
            bound if self.usual_height is None else bound - 2 * float(np.log(self.usual_height[1]))
        )

    @property
    def parameter_sd(self) -> Float64Array:
        """(p,) prior spread of the parameters, infinite for what has none; SUPPORT's is support_sd_mm."""
        spread = SPREAD.copy()
        if self.is_round:
            spread[[E1, E2]] = ROUND_EXPONENT_SD
        if self.name in STANDING:
            spread[[TURN_X, TURN_Y]] = TILT_SD
        return spread

    @property
    def _prior_sd(self) -> Float64Array:
        spread = self.parameter_sd
        spread[SUPPORT] = self.support_sd_mm
        return np.concatenate([spread[list(self.free)], self._weight_sd])

    @property
    def stride(self) -> Float64Array:
        """(k,) the most that an unknown may change at one step."""
        return np.concatenate(
            [self.parameter_stride[list(self.free)], np.full(len(self._weight_sd), WEIGHT_STRIDE)]
        )

    @property
    def _weight_sd(self) -> Float64Array:
        return self.weight_sd if self.has_displacement else np.empty(0)

    def bounded(self, unknowns: Float64Array) -> Float64Array:
        """The unknowns within what they may be: no misfit of a form may sink its support into the table."""
        p, weights = self.split(unknowns)
        measured_mm, limit = self.parameters[SUPPORT], SUPPORT_BOUND * self.support_sd_mm
        p[SUPPORT] = measured_mm + np.clip(p[SUPPORT] - measured_mm, -limit, limit)
        return np.concatenate([p[list(self.free)], weights])

    def split(self, unknowns: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(p,) all parameters, and the weights."""
        p = self.parameters.copy()
        p[list(self.free)] = unknowns[: len(self.free)]
        return p, unknowns[len(self.free) :]

    def vertices(self, unknowns: Float64Array, cells: int) -> Float64Array:
        """(n, 3) mm, table frame."""
        p, weights = self.split(unknowns)
        return np.asarray(self.shaped(p[None], weights[None], cells)[0], np.float64)

    def moves_along(
        self, unknowns: Float64Array, cells: int, vertex: IntArray, directions: Float64Array
    ) -> Float64Array:
        """(k, n) derivatives of the places of vertices (n,), each counted along a direction (n, 3); by differences."""
        steps = np.concatenate(
            [
                self.parameter_step[list(self.free)],
                np.full(len(unknowns) - len(self.free), WEIGHT_STEP),
            ]
        )
        moved = np.vstack([unknowns, unknowns + np.diag(steps)])
        p = np.tile(self.parameters, (len(moved), 1))
        p[:, list(self.free)] = moved[:, : len(self.free)]
        at = self.shaped(p, moved[:, len(self.free) :], cells)
        jacobian = (at[1:] - at[0]) / steps[:, None, None]
        return np.asarray(np.einsum("knb,nb->kn", jacobian[:, vertex], directions), np.float64)


@dataclass(frozen=True, slots=True)
class Resting:
    """What of a form touches its support. vertex: (k,) the lowest. share: (k,) of each in how the level moves.

    level_mm: of the support, in the frame of the heights.
    """

    level_mm: float
    vertex: IntArray
    share: Float64Array


def resting(heights_mm: Float64Array) -> Resting:
    """The contact of vertices (n,): a patch, so that the level moves smoothly from one lowest vertex to the next."""
    lowest = float(heights_mm.min())
    vertex = np.flatnonzero(heights_mm < lowest + 16 * TUNING.contact_mm)
    over = heights_mm[vertex]
    weight = np.exp((lowest - over) / TUNING.contact_mm)
    weight /= weight.sum()
    level = float(weight @ over)
    return Resting(level, vertex, weight * (1 - (over - level) / TUNING.contact_mm))


def _distinct(vertex: IntArray) -> tuple[IntArray, IntArray]:
    """(m,) the different ones of (n,) vertices, ascending, and (n,) the place of each among them."""
    is_used = np.zeros(int(vertex.max(initial=-1)) + 1, np.bool_)
    is_used[vertex] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[vertex]


@lru_cache
def harmonics(cells: int) -> Float64Array:
    """(n, (DEGREE + 1)^2 - 1) real spherical harmonics of degree 1 and up at the sphere's vertices, mean square one."""
    return real_harmonics(sphere(cells).places, harmonic_orders())


def real_harmonics(directions: Float64Array, orders: Sequence[tuple[int, int]]) -> Float64Array:
    """(n, len(orders)) real spherical harmonics of degree and order at unit directions (n, 3), mean square one.

    Without the sign of Condon and Shortley: the weights' priors are the same for either sign.
    """
    height, azimuth = directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0])
    radius = np.hypot(directions[:, 0], directions[:, 1])
    columns = []
    for degree, order in orders:
        waves = abs(order)
        ratio = math.factorial(degree - waves) / math.factorial(degree + waves)
        size = math.sqrt((2 * degree + 1) * ratio * (1 if order == 0 else 2))
        legendre = Legendre.basis(degree).deriv(waves)(height) * radius**waves
        columns.append(
            size * legendre * (np.cos(waves * azimuth) if order >= 0 else np.sin(waves * azimuth))
        )
    return np.column_stack(columns)


def harmonic_orders(least: int = 1, most: int = DEGREE) -> list[tuple[int, int]]:
    """Degree and order of all harmonics from one degree to another."""
    return [
        (degree, order) for degree in range(least, most + 1) for order in range(-degree, degree + 1)
    ]


@dataclass(frozen=True, slots=True)
class Superellipsoid(Form):
    """SUPPORT is the height that it rests at; where SUNK is free, it is cut flat that deep over its lowest point.

    TAPER: relative change of the section from the middle to the end of the C axis. BEND: the angle by which each half
    of that axis is bent towards A. rest_sd: see REST_SD. sunk_sd_mm: prior spread of SUNK.
    """

    rest_sd: float = REST_SD
    sunk_sd_mm: float = float(SPREAD[SUNK])

    @property
    def height_over_width(self) -> tuple[Mapping[int, float], float]:
        """See Form. A heap is cut in its middle; what lies has its height across."""
        if self.name in LYING:
            return {B: 1.0, A: -0.5, C: -0.5}, 0.0
        return {C: 1.0, A: -0.5, B: -0.5}, -float(np.log(2)) if self.name == "heap" else 0.0

    @property
    def parameter_sd(self) -> Float64Array:
        """See Form."""
        spread: Float64Array = Form.parameter_sd.__get__(self)
        spread[SUNK] = self.sunk_sd_mm
        return spread

    @property
    def weight_sd(self) -> Float64Array:
        """Falls with the degree; degree one would only move or tilt what the parameters already move and tilt."""
        return np.array(
            [
                (LATHE_SD if order == 0 else self.rest_sd)
                / degree
                * (DEGREE_ONE if degree == 1 else 1.0)
                for degree, order in harmonic_orders()
            ]
        )

    def bounded(self, unknowns: Float64Array) -> Float64Array:
        """See Form; of exponents and depth as well."""
        p, weights = self.split(Form.bounded(self, unknowns))
        p[[E1, E2]] = np.clip(p[[E1, E2]], *LOG_EXPONENTS)
        p[SUNK] = np.clip(p[SUNK], 0.0, 2 * np.exp(p[C]))
        return np.concatenate([p[list(self.free)], weights])

    def topology(self, cells: int) -> Topology:
        """A sphere's."""
        return sphere(cells)

    def shaped(self, p: Float64Array, weights: Float64Array, cells: int) -> Float64Array:
        """See Form. Displaced along the normals, by the weights in mean radii, and let down on the support."""
        return np.stack(
            [self._shaped(each, some, cells) for each, some in zip(p, weights, strict=True)]
        )

    def _shaped(self, p: Float64Array, weights: Float64Array, cells: int) -> Float64Array:
        own = self._own(p[None], sphere(cells).places, _waves(weights, cells))[0]
        at = own @ self._turn(p).T
        place = np.array([p[X], p[Y], p[SUPPORT] - resting(at[:, 2]).level_mm])
        return np.asarray(at + place, np.float64)

    def moves_along(
        self, unknowns: Float64Array, cells: int, vertex: IntArray, directions: Float64Array
    ) -> Float64Array:
        """See Form; by differences of the vertices that are asked for."""
        used, place = _distinct(vertex)
        moves = self._moves(unknowns, cells, used)
        along = np.einsum("nb,nb->n", moves.raised[place], directions)
        by_weight = moves.harmonics.T[:, place] * along - moves.lowest[:, None] * directions[:, 2]
        by_parameter = np.einsum("knb,nb->kn", moves.by_parameter[:, place], directions)
        return np.concatenate([by_parameter, by_weight])

    def _moves(self, unknowns: Float64Array, cells: int, index: IntArray) -> "_Moves":
        p, weights = self.split(unknowns)
        waves, turn = _waves(weights, cells), self._turn(p)
        rest = resting(self._own(p[None], sphere(cells).places, waves)[0] @ turn[2])
        chosen, count = np.append(index, rest.vertex), len(index)
        directions = sphere(cells).places[chosen]
        shaping = [row for row, free in enumerate(self.free) if free not in _PLACING]
        steps = STEP[[self.free[row] for row in shaping]]
        moved = np.tile(p, (len(shaping) + 1, 1))
        moved[np.arange(len(shaping)), [self.free[row] for row in shaping]] += steps
        own = self._own(moved, directions, waves[chosen])
        out = np.zeros((len(self.free), len(chosen), 3))
        out[shaping] = (own[:-1] - own[-1]) @ turn.T / steps[:, None, None]
        for row, free in enumerate(self.free):
            if free in (X, Y, SUPPORT):
                out[row, :, (X, Y, SUPPORT).index(free)] = 1.0
            elif free in _PLACING:
                turning = p.copy()
                turning[free] += STEP[free]
                out[row] = own[-1] @ (self._turn(turning) - turn).T / STEP[free]
        is_let_down = [row for row, free in enumerate(self.free) if free not in (X, Y, SUPPORT)]
        out[is_let_down, :, 2] -= (out[is_let_down, count:, 2] @ rest.share)[:, None]
        harmonic = harmonics(cells)[chosen, : len(weights)]
        higher = self._own(p[None], directions, waves[chosen] + WEIGHT_STEP)[0]
        raised = (higher - own[-1]) @ turn.T / WEIGHT_STEP
        lowest = (rest.share * raised[count:, 2]) @ harmonic[count:]
        return _Moves(out[:, :count], raised[:count], harmonic[:count], lowest)

    def _own(self, p: Float64Array, directions: Float64Array, waves: Float64Array) -> Float64Array:
        """(q, n, 3) in the form's own axes, of (q, 14) parameters; waves: (n,) displacement, mean radii."""
        return (_cut if self._is_cut else _whole)(p, directions, waves)

    def _turn(self, p: Float64Array) -> Float64Array:
        return cv2.Rodrigues(p[TURN_X : TURN_Z + 1])[0] @ self.axes

    @property
    def _is_cut(self) -> bool:
        return SUNK in self.free


@dataclass(frozen=True, slots=True)
class _Moves:
    """Derivatives of a form's vertices: (q, n, 3) by_parameter; by the weight of a harmonic, it times (n, 3) raised.

    harmonics: (n, w). lowest: (w,) how much each weight raises the level that rests, by which all are let down.
    """

    by_parameter: Float64Array
    raised: Float64Array
    harmonics: Float64Array
    lowest: Float64Array


def _waves(weights: Float64Array, cells: int) -> Float64Array:
    """(n,) displacement of each vertex, mean radii."""
    if len(weights) == 0:
        return np.zeros(len(sphere(cells).places))
    return harmonics(cells) @ weights


def _cut(p: Float64Array, directions: Float64Array, waves: Float64Array) -> Float64Array:
    """(q, n, 3) what stands above the level SUNK over each form's lowest point, closed by a flat base. p: (q, 14).

    The sphere's upper half becomes the surface, its equator the foot, its lower half the base, so that the foot is a
    line of edges. The foot moves on its support, the base within it does not matter.
    """
    e1, e2 = np.exp(p[:, [E1, E2]].T)[:, :, None]
    a, b, c = np.exp(p[:, A : C + 1].T)[:, :, None]
    level = np.clip(p[:, SUNK, None] / c - 1, -LEAST_CUT, LEAST_CUT)
    lowest = np.sign(level) * np.arcsin(np.abs(level) ** (1 / e1))
    latitude = np.arcsin(np.clip(directions[:, 2], 0, 1)) * 2 / np.pi
    latitude = lowest + (np.pi / 2 - lowest) * latitude
    flat = np.hypot(directions[:, 0], directions[:, 1])
    around = directions[:, :2] / np.maximum(flat, 1e-12)[:, None]
    share = np.where(directions[:, 2] < 0, flat, 1.0) * _power(np.cos(latitude), e1)
    x, y = share * _power(around[:, 0], e2), share * _power(around[:, 1], e2)
    on_unit = np.stack([x, y, _power(np.sin(latitude), e1)])
    sizes = np.stack([a, b, c])
    normals = _normals(on_unit, sizes, e1, e2)
    normals[2] *= directions[:, 2] > AT_FOOT
    normals *= directions[:, 2] > -AT_FOOT
    return np.moveaxis(on_unit * sizes + _mean_radii(p) * waves * normals, 0, 2)


def _whole(p: Float64Array, directions: Float64Array, waves: Float64Array) -> Float64Array:
    """(q, n, 3) the superellipsoids in their own axes, displaced, tapered, then bent. p: (q, 14)."""
    towards = np.ascontiguousarray(directions.T)  # else all that follows is strided
    x, y, z = np.log(np.abs(towards) + 1e-9)  # NumPy's powers take twice as long
    e1, e2 = np.exp(p[:, [E1, E2]].T)[:, :, None]
    around = np.log(np.exp(2 / e2 * x) + np.exp(2 / e2 * y))
    scale = np.exp(-e1 / 2 * np.log(np.exp(e2 / e1 * around) + np.exp(2 / e1 * z)))
    on_unit = towards[:, None] * scale
    sizes = np.exp(p[:, A : C + 1].T)[:, :, None]
    out = on_unit * sizes
    if waves.any():
        out += _mean_radii(p) * waves * _normals(on_unit, sizes, e1, e2)
    out[:2] *= 1 + p[:, TAPER, None] * on_unit[2]
    bent = np.abs(p[:, BEND]) > 1e-6
    if bent.any():
        radius = (sizes[2, :, 0] / np.where(bent, p[:, BEND], 1.0))[bent, None]
        angle, reach = out[2, bent] / radius, radius - out[0, bent]
        out[0, bent], out[2, bent] = radius - reach * np.cos(angle), reach * np.sin(angle)
    return np.moveaxis(out, 0, 2)


def _normals(
    on_unit: Float64Array, sizes: Float64Array, e1: Float64Array, e2: Float64Array
) -> Float64Array:
    """(3, q, n) outward normals of superellipsoids, from their implicit function, where half-axes (3, q, 1) are one."""
    size = np.abs(on_unit) + 1e-9
    slope = np.exp(np.log(size) * np.stack([2 / e2, 2 / e2, 2 / e1]))
    slope[:2] *= np.exp((e2 / e1 - 1) * np.log(slope[0] + slope[1]))
    slope = np.copysign(slope, on_unit) / (size * sizes)
    return np.asarray(slope / np.sqrt((slope**2).sum(axis=0)), np.float64)


def _mean_radii(p: Float64Array) -> Float64Array:
    """(q, 1)."""
    return np.asarray(np.exp(p[:, A : C + 1].mean(axis=1))[:, None], np.float64)


def _power(base: Float64Array, exponent: Float64Array) -> Float64Array:
    """Signed power, as in Barr's parametrisation."""
    return np.sign(base) * np.abs(base) ** exponent


@dataclass(frozen=True, slots=True)
class Ring(Form):
    """A ring that lies on its support: A is its tube's middle line, B and C the tube's half width and half height.

    E1 stretches it along its first axis against the second (logarithm of the ratio). E2, SUNK, TAPER and BEND do not
    exist.
    """

    @property
    def height_over_width(self) -> tuple[Mapping[int, float], float]:
        """See Form. Its width is that of middle line and tube together, whose logarithm is linear about the start."""
        parts = np.exp(self.parameters[[A, B]])
        of_line, of_tube = parts / parts.sum()
        added = of_line * self.parameters[A] + of_tube * self.parameters[B] - np.log(parts.sum())
        return {C: 1.0, A: -of_line, B: -of_tube}, float(added)

    @property
    def weight_sd(self) -> Float64Array:
        """Falls with the waves."""
        terms = [
            wave + 0.5 * term
            for wave in range(1, RING_WAVES + 1)
            for _ in range(2)
            for term in range(3)
        ]
        return RING_SD / np.array(terms)

    def topology(self, cells: int) -> Topology:
        """A ring's, with about as many vertices as a sphere's."""
        return ring(int(3.3 * cells), int(1.7 * cells))

    def shaped(self, p: Float64Array, weights: Float64Array, cells: int) -> Float64Array:
        """See Form. The weights change the tube's width."""
        turn, tube = self.topology(cells).places.T
        width = np.ones((len(p), 1))
        if weights.size:
            across = (np.ones_like(tube), np.cos(tube), np.sin(tube))
            waves = range(1, RING_WAVES + 1)
            terms = [
                f(wave * turn) * term for wave in waves for f in (np.cos, np.sin) for term in across
            ]
            width = width + weights @ np.stack(terms)
        middle, half_width, half_height = np.exp(p[:, A : C + 1].T)[:, :, None]
        stretch, radius = np.exp(p[:, E1, None] / 2), middle + half_width * width * np.cos(tube)
        own = np.stack(
            [
                radius * np.cos(turn) * stretch,
                radius * np.sin(turn) / stretch,
                half_height * width * np.sin(tube),
            ],
            axis=2,
        )
        turns = np.stack([cv2.Rodrigues(each)[0] @ self.axes for each in p[:, TURN_X : TURN_Z + 1]])
        at = own @ turns.swapaxes(1, 2)
        at[:, :, :2] += p[:, None, [X, Y]]
        at[:, :, 2] += (p[:, SUPPORT] - [resting(heights).level_mm for heights in at[:, :, 2]])[
            :, None
        ]
        return np.asarray(at, np.float64)
