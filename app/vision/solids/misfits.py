"""How far a form is from what the views show: outlines, the parts of them that it leaves out, parallax.

A form at unknowns + evidence (Seen) -> residuals, px, each with its sd, weight and derivative. All change continuously
with the unknowns: a vertex takes part by how far it faces the camera, not by whether it does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from app.vision.geometry.masks import filled, window_around
from app.vision.geometry.mesh import IntArray, Topology, faces_towards, unit, vertex_normals
from app.vision.model import Float64Array
from app.vision.solids.contour import Contour, contour_generator
from app.vision.solids.fields import OutlineField, ParallaxField
from app.vision.solids.forms import EXACT, Form
from app.vision.solids.outline_snap import STEP_PX, Outline
from app.vision.solids.seen import Seen
from app.vision.solids.side_view import SideView
from app.vision.solids.surface_match import SUBPIXEL_BITS, fixed_point
from app.vision.tuning import TUNING

SAMPLES = np.array(TUNING.samples)
NO_POSE = np.empty(0)


@dataclass(frozen=True, slots=True)
class Misfits:
    """Residuals of a form. Each hangs on one vertex or on a few: those from its `begins` on.

    vertex: (v,). by_point: (v, 3) derivative by its place, px/mm. begins: (n,) the first of each residual's vertices.
    residual_px, sd_px, weight: (n,). unexplained: observations of parallax where the form shows no surface. by_pose:
    (n, p) derivative by the pose of a side view; None: it has no part in these.
    """

    vertex: IntArray
    by_point: Float64Array
    begins: IntArray
    residual_px: Float64Array
    sd_px: Float64Array
    weight: Float64Array
    unexplained: float = 0.0
    by_pose: Float64Array | None = None

    def loss(self, tolerance: float) -> float:
        """-2 log likelihood, by Cauchy: a shadow taken for food or a highlight bends little."""
        scaled = self._scaled(tolerance)
        measured = float(TUNING.loss_scale**2 * (self.weight * np.log1p(scaled**2)).sum())
        return measured + TUNING.unexplained_loss * self.unexplained

    def precision(self, tolerance: float) -> Float64Array:
        """(n,) of each residual as the loss leaves it (iteratively reweighted least squares)."""
        variance = (tolerance * self.sd_px) ** 2
        return self.weight / variance / (1 + self._scaled(tolerance) ** 2)

    @property
    def middle(self) -> float:
        """The median of the residuals in sds, by weight."""
        size = np.abs(self.residual_px) / self.sd_px
        order = np.argsort(size)
        total = np.cumsum(self.weight[order])
        return float(size[order[np.searchsorted(total, total[-1] / 2)]])

    def _scaled(self, tolerance: float) -> Float64Array:
        return self.residual_px / (tolerance * TUNING.loss_scale * self.sd_px)


def misfits(
    form: Form, unknowns: Float64Array, cells: int, seen: Seen, pose: Float64Array = NO_POSE
) -> Misfits | None:
    """The misfits of a form; None where nothing of the food meets it. pose: of the side view, if there is one."""
    placed = _Placed(form.topology(cells), form.vertices(unknowns, cells), seen)
    parts: list[Misfits | None] = [_of_parallax(placed, field) for field in seen.parallax_fields]
    for view, field in enumerate(seen.outline_fields):
        line = None if field is None else _line_in(placed, view)
        if line is None or field is None:
            continue
        parts.append(_of_outline(placed, line, field))
        if view == 0:
            parts.append(_of_coverage(line, seen.outlines[0], seen.outline_sd_px))
    if seen.side is not None:
        line = _line_from_side(placed, seen.side, pose)
        if line is None:
            return None
        parts.append(_of_outline(placed, line, seen.side.field))
        parts.append(_of_coverage(line, seen.side.outline, seen.outline_sd_px))
    return _together([part for part in parts if part is not None])


def uncovered(form: Form, unknowns: Float64Array, seen: Seen) -> float:
    """Return how many observations the part of the mask is worth that the form, with its hole, does not cover.

    Where another food hides the outline, nothing else draws a form over the whole of the mask.
    """
    vertices, mesh = form.vertices(unknowns, EXACT), form.topology(EXACT)
    is_near = faces_towards(vertices, mesh.faces, seen.camera_mm(0))[mesh.edge_faces]
    pixels, _ = seen.sight.project(vertices[mesh.edges[np.diff(is_near)[:, 0]]].reshape(-1, 3))
    rows, columns = window_around(seen.mask, TUNING.margin_px)  # beyond it nothing is to be covered
    mask = seen.mask[rows, columns]
    line = np.zeros(mask.shape, np.uint8)
    ends = np.clip(pixels - [columns.start, rows.start], 0, np.array(mask.shape[::-1]) - 1)
    cv2.polylines(
        line, list(fixed_point(ends).reshape(-1, 2, 2)), False, 1, 1, cv2.LINE_8, SUBPIXEL_BITS
    )
    return float(np.count_nonzero(mask & ~filled(line > 0))) / TUNING.dense_area_px


@dataclass(frozen=True)
class _Placed:
    """A form's mesh where the unknowns place it, as the views see it. vertices: (n, 3) mm."""

    mesh: Topology
    vertices: Float64Array
    seen: Seen

    @cached_property
    def vertex_normals(self) -> Float64Array:
        """(n, 3) outward, six times the area long for which a vertex stands."""
        return vertex_normals(self.vertices, self.mesh)

    @cached_property
    def outward(self) -> Float64Array:
        """(n, 3) the same of length one."""
        return unit(self.vertex_normals)

    @cached_property
    def first(self) -> tuple[Float64Array, Float64Array]:
        """(n, 2) px in the first view, (n,) parallax, px."""
        return self.seen.sight.project(self.vertices)


@dataclass(frozen=True, slots=True)
class _Line:
    """The outline of a form in a view, as contour_generator has it. pixels: (n, 2). gradient: (n, 2, 3) px/mm.

    by_pose: (n, 2, p) derivative of the pixels by the pose of a side view.
    """

    contour: Contour
    pixels: Float64Array
    gradient: Float64Array
    by_pose: Float64Array | None = None

    @property
    def ends(self) -> tuple[Float64Array, Float64Array]:
        """(k, 2) px where each segment begins, and where it ends."""
        begins, ends = self.contour.segments.T
        return self.pixels[begins], self.pixels[ends]

    def moved(self, point: IntArray, towards: Float64Array) -> tuple[IntArray, Float64Array]:
        """(2 k,) vertices and (2 k, 3) derivatives, px/mm, of points (k,) counted along (k, 2) in the picture."""
        by_point = np.einsum("na,nab->nb", towards, self.gradient[point])
        share = self.contour.share[point]
        shares = np.column_stack([1 - share, share]).ravel()
        by_vertex = np.repeat(by_point, 2, axis=0) * shares[:, None]
        return self.contour.vertex[point].ravel(), by_vertex

    def by_the_pose(self, point: IntArray, towards: Float64Array) -> Float64Array | None:
        """(k, p) derivatives of points (k,) by the pose, counted along (k, 2) in the picture."""
        if self.by_pose is None:
            return None
        return np.asarray(np.einsum("na,nap->np", towards, self.by_pose[point]), np.float64)


def _line_in(placed: _Placed, view: int) -> _Line | None:
    seen = placed.seen
    contour = contour_generator(placed.vertices, placed.outward, placed.mesh, seen.camera_mm(view))
    if len(contour.points) < TUNING.min_outline:
        return None
    pixels = seen.pixels(contour.points, view)
    return _Line(contour, pixels, seen.pixel_gradient(contour.points, view))


def _line_from_side(placed: _Placed, side: SideView, pose: Float64Array) -> _Line | None:
    camera = side.camera_mm(pose)
    contour = contour_generator(placed.vertices, placed.outward, placed.mesh, camera)
    if len(contour.points) < TUNING.min_outline:
        return None
    return _Line(
        contour,
        side.project(contour.points, pose),
        side.pixel_gradient(contour.points, pose),
        side.pose_gradient(contour.points, pose),
    )


def _of_outline(placed: _Placed, line: _Line, field: OutlineField) -> Misfits:
    """Distance of the form's outline from the food's, px: of each point the mean over the half segments around it."""
    segments = line.contour.segments
    start, end = line.ends
    along = SAMPLES[:, None, None]
    samples = (start + along * (end - start)).reshape(-1, 2)
    distance, slope, weight = field.at(samples)
    lengths = np.sqrt(((end - start) ** 2).sum(axis=1)) / len(SAMPLES)
    values = np.stack([np.ones_like(distance), distance, slope[:, 0], slope[:, 1]]) * weight
    values = values.reshape(len(values), len(SAMPLES), -1) * lengths
    count = len(line.pixels)
    # Each point ends one segment and begins another.
    summed = np.empty((len(values), count))
    summed[:, segments[:, 0]] = np.einsum("s,vsk->vk", 1 - SAMPLES, values)
    summed[:, segments[:, 1]] += np.einsum("s,vsk->vk", SAMPLES, values)
    total = summed[0]
    distance, *towards = summed[1:] / np.maximum(total, 1e-9)
    slope = np.column_stack(towards)
    vertex, by_vertex = line.moved(np.arange(count), slope)
    weight = total * (field.length_px / max(float(total.sum()), 1e-9) / TUNING.outline_run_px)
    sd = np.full(count, placed.seen.outline_sd_px)
    by_pose = line.by_the_pose(np.arange(count), slope)
    begins = 2 * np.arange(count)
    return Misfits(vertex, by_vertex, begins, distance, sd, weight, by_pose=by_pose)


def _of_coverage(line: _Line, outline: Outline | None, sd_px: float) -> Misfits | None:
    """Points of the food's outline in a view, px, that the form's does not come near: a banana's end, a hole.

    They draw the nearest point of the form's outline towards them.
    """
    if outline is None:
        return None
    points, weights = outline.points_px[::2], 2 * outline.weights[::2]
    segments = line.contour.segments
    start, end = line.ends
    towards = end - start
    length2 = np.maximum((towards**2).sum(axis=1), 1e-9)
    apart_x, apart_y = (points[:, axis, None] - start[:, axis] for axis in (0, 1))
    share = np.clip((apart_x * towards[:, 0] + apart_y * towards[:, 1]) / length2, 0, 1)
    distance2 = (apart_x - share * towards[:, 0]) ** 2 + (apart_y - share * towards[:, 1]) ** 2
    number = distance2.argmin(axis=1)
    distance = np.sqrt(distance2[np.arange(len(points)), number])
    kept = np.flatnonzero((distance > TUNING.unexplained_px) & (weights > 0))
    if len(kept) == 0:
        return None
    number, distance = number[kept], distance[kept]
    share = share[kept, number]
    nearest = start[number] + share[:, None] * towards[number]
    direction = (nearest - points[kept]) / distance[:, None]
    end_of = segments[number, (share > 0.5).astype(np.int64)]
    vertex, by_vertex = line.moved(end_of, direction)
    return Misfits(
        vertex,
        by_vertex,
        2 * np.arange(len(kept)),
        distance - TUNING.unexplained_px,
        np.full(len(kept), sd_px),
        TUNING.coverage_weight * weights[kept] * STEP_PX / TUNING.outline_run_px,
        by_pose=line.by_the_pose(end_of, direction),
    )


def _of_parallax(placed: _Placed, field: ParallaxField) -> Misfits:
    """Parallax of the form's points less the measured one, px; each vertex speaks for the area around it.

    What is known where the form shows no surface is unexplained.
    """
    sight, vertices = placed.seen.sight, placed.vertices
    normals = placed.vertex_normals
    first, second = sight.cameras_mm
    ray = vertices - first
    depth = ray @ sight.pair.rotation[2]
    ray = ray / depth[:, None]
    outward = placed.outward
    slant = -np.einsum("ij,ij->i", outward, ray)
    slant_second = -np.einsum("ij,ij->i", outward, unit(vertices - second))
    height = vertices[:, 2] - vertices[:, 2].min()
    share = _ramp(slant, *TUNING.facing)
    share *= _ramp(slant_second, *TUNING.facing_second)
    share *= _ramp(height, 0.0, TUNING.foot_mm)
    index = np.flatnonzero(share)
    pixels, parallax = placed.first
    measured, sd, known = field.at(pixels[index])
    is_known = known > 0
    if not is_known.any():
        nothing = np.empty(0)
        unexplained = field.known_px / field.area_px
        none = np.empty(0, np.int64)
        return Misfits(none, np.empty((0, 3)), none, nothing, nothing, nothing, unexplained)
    index, measured, sd = index[is_known], measured[is_known], sd[is_known]
    share = share[index] * known[is_known]
    # A vertex speaks for a third of the triangles around it.
    depth = depth[index]
    seen_mm2 = np.abs(np.einsum("ij,ij->i", normals[index], ray[index])) / 6
    seen_px2 = share * seen_mm2 * (sight.pair.focal_px / depth) ** 2
    # A surface that moves by its normals' component changes the depth along a ray by that over the slant.
    per_mm = sight.parallax_per_mm(depth)
    by_point = outward[index] * (-per_mm / slant[index])[:, None]
    area_px: Float64Array | float = field.area_px
    if field.is_measurement:
        # A depth map shows the food itself, which departs from any form: of what a map says that is nearly exact, the
        # form's own error is what counts.
        noise, rough = sd**2, (TUNING.roughness_mm * per_mm) ** 2
        rough_px2 = (TUNING.roughness_run_mm * sight.pair.focal_px / depth) ** 2
        area_px = (noise * field.area_px + rough * rough_px2) / (noise + rough)
        sd = np.sqrt(noise + rough)
    weight = seen_px2 / area_px
    left_px2 = max(field.known_px - float(seen_px2.sum()), 0.0)
    unexplained = left_px2 * float(weight.sum()) / float(seen_px2.sum())
    residual = parallax[index] - measured
    return Misfits(index, by_point, np.arange(len(index)), residual, sd, weight, unexplained)


def _ramp(value: Float64Array, low: float, high: float) -> Float64Array:
    """(n,) from 0 at low to 1 at high, with a continuous slope."""
    share = np.clip((value - low) / (high - low), 0.0, 1.0)
    return share * share * (3 - 2 * share)


def _together(parts: list[Misfits]) -> Misfits | None:
    if not any(len(part.residual_px) for part in parts):
        return None
    ends = np.cumsum([0, *(len(part.vertex) for part in parts)])
    return Misfits(
        np.concatenate([part.vertex for part in parts]),
        np.concatenate([part.by_point for part in parts]),
        np.concatenate([part.begins + end for part, end in zip(parts, ends, strict=False)]),
        np.concatenate([part.residual_px for part in parts]),
        np.concatenate([part.sd_px for part in parts]),
        np.concatenate([part.weight for part in parts]),
        sum(part.unexplained for part in parts),
        _by_pose(parts),
    )


def _by_pose(parts: Sequence[Misfits]) -> Float64Array | None:
    """(n, p) of all; those that a pose has no part in do not change with it."""
    of_pose = next((part.by_pose for part in parts if part.by_pose is not None), None)
    if of_pose is None:
        return None
    still = np.zeros_like(of_pose[0])
    return np.concatenate(
        [
            np.tile(still, (len(part.residual_px), 1)) if part.by_pose is None else part.by_pose
            for part in parts
        ]
    )
