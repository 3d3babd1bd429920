"""A form fitted to what the views show of one food: outlines, parallax, the support; maximum a posteriori.

Evidence (Seen) + a family with its start (forms.py) -> unknowns, their covariance, the volume. Gauss-Newton with
Levenberg's damping; every misfit counts by a Cauchy loss, so that a shadow taken for food or a highlight bends little.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from app.core.units import ml_from_mm3
from app.vision.geometry.masks import filled, inward_px, window_around
from app.vision.geometry.mesh import (
    IntArray,
    Topology,
    enclosed_gradient_mm2,
    enclosed_mm3,
    face_normals,
    normals_towards,
    outline_vertices,
    summed_around,
    unit,
)
from app.vision.geometry.nearest import Nearest
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.shape.forms import COARSE, EXACT, Form
from app.vision.shape.surface_match import WINDOW_PX, SurfaceParallax, draw_mask
from app.vision.shape.tuning import TUNING
from app.vision.shape.volume import MOST_SD
from app.vision.stereo.disparity import DisparityMap
from app.vision.stereo.outline_snap import STEP_PX, Outline
from app.vision.stereo.pinhole_view import PinholeView
from app.vision.stereo.sight import Sight

PAIR = 2  # views; those beyond are the others


@dataclass(frozen=True, slots=True)
class Seen:
    """What the views show of a food. mask: (H, W). inward_px: (H, W) distance to the mask's outline.

    outlines: in the first and the second view, then in the others. dense: from the whole pair, where no surface is
    known yet. surface: measured along a form that is near the food's. by_maps: the same by depth maps beside
    the pair. outline_sd_px: of the outlines.
    """

    sight: Sight
    mask: MaskArray
    inward_px: Float32Array
    outlines: tuple[Outline | None, ...]
    dense: DisparityMap
    surface: SurfaceParallax | None = None
    others: tuple[PinholeView, ...] = ()
    by_maps: tuple[SurfaceParallax, ...] = ()
    outline_sd_px: float = TUNING.outline_sd_px

    def pixel_gradient(self, points_table: Float64Array, view: int) -> Float64Array:
        """(n, 2, 3) derivative of the pixel in a view, numbered as outlines, by the point, px/mm."""
        if view < PAIR:
            return self.sight.pixel_gradient(points_table, view)
        return self.others[view - PAIR].pixel_gradient(points_table)


@dataclass(frozen=True, slots=True)
class _Terms:
    """Misfits that hang on one vertex each. vertex: (n,). by_point: (n, 3) derivative by its place, px/mm.

    sd_px: (n,); a fit's tolerance multiplies all of them. unmeasured: how many observations more the form would show
    if parallax were known everywhere.
    """

    vertex: IntArray
    by_point: Float64Array
    residual_px: Float64Array
    sd_px: Float64Array
    weight: Float64Array
    unmeasured: float = 0.0

    def loss(self, tolerance: float) -> float:
        measured = float(
            TUNING.loss_scale**2 * (self.weight * np.log1p(self._scaled(tolerance) ** 2)).sum()
        )
        return measured + TUNING.unmeasured_loss * self.unmeasured

    def precision(self, tolerance: float) -> Float64Array:
        """(n,) of each term as the loss leaves it (iteratively reweighted least squares)."""
        return self.weight / (tolerance * self.sd_px) ** 2 / (1 + self._scaled(tolerance) ** 2)

    def _scaled(self, tolerance: float) -> Float64Array:
        return self.residual_px / (tolerance * TUNING.loss_scale * self.sd_px)


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of a form's unknowns: (k,) its middle and (k, k) its precision."""

    expected: Float64Array
    precision: Float64Array


@dataclass(frozen=True)
class FormAt:
    """A form at unknowns (k,), and how it fits there what is seen. cells: COARSE or FINE.

    Fits with different tolerances that come by the same place share what is computed there.
    """

    form: Form
    cells: int
    unknowns: Float64Array
    prior: _Prior
    terms: _Terms

    def cost(self, tolerance: float = 1.0) -> float:
        """-2 log of the posterior, all that a step is judged by."""
        apart = self.unknowns - self.prior.expected
        return self.terms.loss(tolerance) + float(apart @ self.prior.precision @ apart)

    def linearised(self, tolerance: float = 1.0) -> tuple[Float64Array, Float64Array]:
        """(k, k) Gauss-Newton's matrix and (k,) half the gradient, which take longer than the cost itself."""
        weighted = self._jacobian * self.terms.precision(tolerance)
        slope = weighted @ self.terms.residual_px + self.prior.precision @ (
            self.unknowns - self.prior.expected
        )
        return weighted @ self._jacobian.T + self.prior.precision, slope

    @cached_property
    def _jacobian(self) -> Float64Array:
        return self.form.moves_along(
            self.unknowns, self.cells, self.terms.vertex, self.terms.by_point
        )


@dataclass(frozen=True)
class FormFit:
    """A form where its posterior is at a maximum. cost: -2 log of it there. tolerance: that it was fitted with.

    uncovered: how many observations the part of the food's mask would be that a fine fit does not cover.

    What a coarse fit never needs (the volume, its spread, the evidence) is computed when it is first asked for.
    """

    at: FormAt
    cost: float
    tolerance: float = 1.0
    uncovered: float = 0.0

    @property
    def form(self) -> Form:
        """Family and start."""
        return self.at.form

    @property
    def unknowns(self) -> Float64Array:
        """(k,) at the maximum."""
        return self.at.unknowns

    @property
    def observations(self) -> float:
        """Number of independent observations that took part."""
        return float(self.at.terms.weight.sum())

    @cached_property
    def evidence(self) -> float:
        """As a cost, -2 log: with the price of what had to be fitted, log of det(precision times prior variance)."""
        log_occam = float(np.linalg.slogdet(self._normal)[1]) - self.form.prior_log_determinant
        return self.cost + TUNING.unmeasured_loss * self.uncovered + TUNING.occam_weight * log_occam

    @cached_property
    def volume_ml(self) -> float:
        """Volume of the form's finest mesh."""
        vertices, mesh = self.form.vertices(self.unknowns, EXACT), self.form.topology(EXACT)
        return ml_from_mm3(enclosed_mm3(vertices, mesh.faces))

    @cached_property
    def volume_sd_ml(self) -> float:
        """By the covariance of the unknowns."""
        form, cells = self.form, self.at.cells
        vertices = form.vertices(self.unknowns, cells)
        by_vertex = enclosed_gradient_mm2(vertices, form.topology(cells))
        gradient = form.moves_along(self.unknowns, cells, np.arange(len(vertices)), by_vertex).sum(
            axis=1
        )
        return ml_from_mm3(
            float(np.sqrt(max(float(gradient @ _solved(self._normal, gradient)), 0.0)))
        )

    @property
    def is_determined(self) -> bool:
        """Whether the 90 % interval of the volume lies within a third and three times of it.

        It does not for a ring as thin as a wire, which follows an outline and touches no surface.
        """
        return self.volume_sd_ml < MOST_SD * self.volume_ml

    @cached_property
    def _normal(self) -> Float64Array:
        return self.at.linearised(self.tolerance)[0]


def form_at(
    form: Form, unknowns: Float64Array, cells: int, seen: Seen, prior: _Prior | None = None
) -> FormAt | None:
    """Return the form where the unknowns (k,) place it; None where nothing of the food meets it.

    prior: the form's own, if it was computed before.
    """
    terms = _terms(form, unknowns, cells, seen)
    if terms is None:
        return None
    return FormAt(
        form, cells, unknowns, prior or _Prior(form.expected, form.prior_precision), terms
    )


def fit_form(
    form: Form,
    seen: Seen,
    cells: int,
    rounds: int,
    start: Float64Array | FormAt | None = None,
    tolerance: float = 1.0,
) -> FormFit | None:
    """Fit from `start` (or the form's own); None where nothing of the food meets the form. cells: COARSE or FINE.

    tolerance: by which all misfits may be larger than usual. What a form covers changes by leaps from place to place,
    so that a step may rise over the last costs but not over all of them (Grippo, Lampariello and Lucidi, 1986).
    """
    if not isinstance(start, FormAt):
        start = form_at(form, form.start if start is None else start, cells, seen)
        if start is None:
            return None
    now, stride = start, form.stride
    best = FormFit(start, start.cost(tolerance), tolerance)
    costs, idle = deque([best.cost], TUNING.remembered), 0
    damping, least, most = TUNING.damping
    converged, patience = TUNING.converged_fine, TUNING.patience_fine
    if cells == COARSE:
        converged, patience = TUNING.converged_coarse, TUNING.patience_coarse
    for _ in range(rounds):
        normal, slope = now.linearised(tolerance)
        for _ in range(TUNING.tries):
            step = -_solved(normal + damping * np.diag(np.diag(normal)), slope)
            step /= max(1.0, float(np.abs(step / stride).max()))
            trial = form_at(form, form.bounded(now.unknowns + step), cells, seen, start.prior)
            if trial is not None and (cost := trial.cost(tolerance)) < max(costs):
                break
            damping = min(damping * 5, most)
        else:
            break
        damping = max(damping / 4, least)
        now = trial
        costs.append(cost)
        idle = 0 if best.cost - cost > converged * best.cost else idle + 1
        if cost < best.cost:
            best = FormFit(now, cost, tolerance)
        if idle == patience:
            break
    return best if cells == COARSE else replace(best, uncovered=_uncovered(best.at, seen))


def _solved(normal: Float64Array, right: Float64Array) -> Float64Array:
    """Solve normal @ x = right, for the shortest x where the food shows too little of the form to tell some unknown."""
    try:
        return np.asarray(np.linalg.solve(normal, right), np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0], np.float64)


@dataclass(frozen=True, slots=True)
class _Placed:
    """A form's mesh where the unknowns place it, as the views see it.

    normals: (m, 3) see face_normals. parallax_px: (n,). pixels: (n, 2) in each view whose outline is known.
    is_facing: (m,) towards each of these.
    """

    mesh: Topology
    vertices: Float64Array
    normals: Float64Array
    parallax_px: Float64Array
    pixels: Mapping[int, Float64Array]
    is_facing: Mapping[int, MaskArray]


def _placed(form: Form, unknowns: Float64Array, cells: int, seen: Seen) -> _Placed:
    mesh, vertices = form.topology(cells), form.vertices(unknowns, cells)
    normals, corners = face_normals(vertices, mesh.faces), vertices.take(mesh.faces[:, 0], axis=0)
    cameras = *seen.sight.cameras_mm, *(view.centre_mm for view in seen.others)
    first, parallax = seen.sight.project(vertices)
    pixels, is_facing = {0: first}, {}
    for view in (view for view, line in enumerate(seen.outlines) if line is not None):
        is_facing[view] = normals_towards(normals, corners, cameras[view])
        if view >= PAIR:
            pixels[view] = seen.others[view - PAIR].project(vertices)
        elif view == 1:
            pixels[view] = seen.sight.in_view(first, parallax, 1)
    return _Placed(mesh, vertices, normals, parallax, pixels, is_facing)


def _terms(form: Form, unknowns: Float64Array, cells: int, seen: Seen) -> _Terms | None:
    placed = _placed(form, unknowns, cells, seen)
    parts = _parallax_terms(placed, seen)
    for view, is_facing in placed.is_facing.items():
        index, share = outline_vertices(placed.vertices, placed.mesh, is_facing)
        if len(index) < TUNING.min_outline:
            continue
        parts.append(_outline_terms(placed, index, share, seen, view, is_folded=form.is_folded))
        if view == 0:
            parts.append(_coverage_terms(placed, index, seen, is_flat=form.is_flat))
    kept = [part for part in parts if part is not None]
    if not kept:
        return None
    return _Terms(
        np.concatenate([part.vertex for part in kept]),
        np.concatenate([part.by_point for part in kept]),
        np.concatenate([part.residual_px for part in kept]),
        np.concatenate([part.sd_px for part in kept]),
        np.concatenate([part.weight for part in kept]),
        sum(part.unmeasured for part in kept),
    )


def _outline_terms(
    placed: _Placed,
    index: IntArray,
    share: Float64Array,
    seen: Seen,
    view: int,
    *,
    is_folded: bool,
) -> _Terms | None:
    """Distance of the form's outline from the nearest point of the food's, along that point's normal, px."""
    line = seen.outlines[view]
    if line is None:
        return None
    pixels = placed.pixels[view][index]
    _, nearest = line.nearest.query(pixels)
    towards = line.normals[nearest]
    residual = ((pixels - line.points_px[nearest]) * towards).sum(axis=1)
    by_point = np.einsum("na,nab->nb", towards, seen.pixel_gradient(placed.vertices[index], view))
    length = cv2.arcLength(cv2.convexHull(pixels.astype(np.float32)), closed=True)
    weight = line.weights[nearest] * share * length / TUNING.outline_run_px
    if is_folded:
        weight = np.where(_is_hidden(placed, seen, view, pixels), 0.0, weight)
    return _Terms(index, by_point, residual, np.full(len(residual), seen.outline_sd_px), weight)


def _coverage_terms(
    placed: _Placed, index: IntArray, seen: Seen, *, is_flat: bool
) -> _Terms | None:
    """Points of the food's outline in the first view, px, that the form's does not come near: a banana's end, a hole.

    They draw the nearest point of the form's outline towards them. is_flat: the outline has long straight edges, along
    which it comes near, too, and not only at its vertices.
    """
    line = seen.outlines[0]
    if line is None:
        return None
    if is_flat:
        index, pixels = _sampled_edges(placed)
    else:
        pixels = placed.pixels[0][index]
    distance, nearest = Nearest(pixels).query(line.points_px)
    apart = np.flatnonzero((distance > TUNING.unexplained_px) & (line.weights > 0))
    if len(apart) == 0:
        return None
    towards = (pixels[nearest[apart]] - line.points_px[apart]) / distance[apart][:, None]
    gradient = seen.sight.pixel_gradient(placed.vertices[index], 0)[nearest[apart]]
    weight = TUNING.coverage_weight * line.weights[apart] * STEP_PX / TUNING.outline_run_px
    return _Terms(
        index[nearest[apart]],
        np.einsum("na,nab->nb", towards, gradient),
        distance[apart] - TUNING.unexplained_px,
        np.full(len(apart), seen.outline_sd_px),
        weight,
    )


def _uncovered(at: FormAt, seen: Seen) -> float:
    """Return how many observations the part of the mask is worth that the form, with its hole, does not cover.

    Where another food hides the outline, nothing else draws a form over the whole of the mask.
    """
    placed = _placed(at.form, at.unknowns, at.cells, seen)
    rows, columns = window_around(seen.mask, TUNING.margin_px)  # beyond it nothing is to be covered
    mask = seen.mask[rows, columns]
    covered = filled(
        draw_mask(placed.pixels[0] - (columns.start, rows.start), placed.mesh.faces, mask.shape)
    )
    return float(np.count_nonzero(mask & ~covered)) / TUNING.dense_area_px


def _sampled_edges(placed: _Placed) -> tuple[IntArray, Float64Array]:
    """(n, 2) px, evenly along the outline's edges in the first view, and (n,) the end of its edge nearest to each."""
    is_facing, edges = placed.is_facing[0], placed.mesh.edges
    edges = edges[
        is_facing[placed.mesh.edge_faces[:, 0]] != is_facing[placed.mesh.edge_faces[:, 1]]
    ]
    start, end = (placed.pixels[0][edges[:, side]] for side in (0, 1))
    steps = np.maximum(
        np.ceil(np.linalg.norm(end - start, axis=1) / TUNING.unexplained_px), 1
    ).astype(np.int64)
    edge = np.repeat(np.arange(len(edges)), steps)
    first = np.repeat(np.cumsum(steps) - steps, steps)
    share = (np.arange(len(edge)) - first + 0.5) / steps[edge]
    return edges[edge, (share > 0.5).astype(np.int64)], start[edge] + share[:, None] * (
        end - start
    )[edge]


def _is_hidden(placed: _Placed, seen: Seen, view: int, pixels: Float64Array) -> MaskArray:
    """(n,) whether points of the contour generator lie well within what the form covers.

    What lies at its convex hull cannot, and of the others only the triangles near them tell: drawing takes longest.
    """
    out = np.zeros(len(pixels), np.bool_)
    corners = placed.pixels[view]
    low = np.floor(corners.min(axis=0)) - 3
    size = np.ceil(np.ptp(corners, axis=0)).astype(np.int64) + 8
    inner = np.flatnonzero(_depth_in_hull_px(pixels) > TUNING.hull_px)
    if len(inner) == 0 or (size > max(seen.mask.shape)).any():
        return out
    faces = placed.mesh.faces[placed.is_facing[view]]
    faces = faces[_is_near(corners.take(faces, axis=0), pixels[inner])]
    covered = draw_mask(corners - low, faces, (int(size[1]), int(size[0])))
    depth = inward_px(covered, 3)
    column, row = np.rint(pixels[inner] - low).astype(np.int64).T
    out[inner] = depth[row, column] > TUNING.hidden_px
    return out


def _depth_in_hull_px(pixels: Float64Array) -> Float64Array:
    """(n,) distance of each point from the convex hull of all."""
    hull = cv2.convexHull(pixels.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    along = unit(np.roll(hull, -1, axis=0) - hull)
    square = np.column_stack([along[:, 1], -along[:, 0]])
    apart = pixels @ square.T - (hull * square).sum(axis=1)
    return np.asarray(np.abs(apart).min(axis=1), np.float64)


def _is_near(triangles: Float64Array, pixels: Float64Array) -> MaskArray:
    """(m,) whether the box around each triangle (m, 3, 2) comes within reach of any of the points (n, 2)."""
    low, high = triangles.min(axis=1) - TUNING.near_px, triangles.max(axis=1) + TUNING.near_px
    near = [
        (low[:, axis, None] < pixels[:, axis]) & (pixels[:, axis] < high[:, axis, None])
        for axis in (0, 1)
    ]
    return np.asarray((near[0] & near[1]).any(axis=1), np.bool_)


def _parallax_terms(placed: _Placed, seen: Seen) -> list[_Terms | None]:
    """Parallax of the form's points less the measured one, px; each point speaks for the area around it.

    The photographs and each depth map measure it on their own.
    """
    sight, vertices = seen.sight, placed.vertices
    normals = summed_around(placed.normals, placed.mesh)
    support_mm = float(vertices[:, 2].min())
    first, second = sight.cameras_mm
    ray = vertices - first
    depth = ray @ sight.pair.rotation[2]
    ray = ray / depth[:, None]
    outward = unit(normals)
    slant = np.einsum("ij,ij->i", outward, ray)
    slant_second = np.einsum("ij,ij->i", outward, unit(vertices - second))
    is_facing = (slant < -TUNING.facing) & (slant_second < -TUNING.facing_second)
    is_open = is_facing & (vertices[:, 2] > support_mm + TUNING.foot_mm)
    index = np.flatnonzero(is_open)
    if len(index) == 0:
        return []
    # A vertex speaks for a third of the triangles around it.
    seen_mm2 = np.abs(np.einsum("ij,ij->i", normals[index], ray[index])) / 6
    seen_px2 = seen_mm2 * (sight.pair.focal_px / depth[index]) ** 2
    # A surface that moves by its normals' component changes the depth along a ray by that over the slant.
    per_mm = sight.parallax_per_mm(depth[index]) / slant[index]
    by_point = outward[index] * per_mm[:, None]

    def terms(
        measured: Float64Array, sd: Float64Array, area_px: Float64Array | float, most_sd_px: float
    ) -> _Terms | None:
        weight = seen_px2 / area_px
        is_measured = np.isfinite(measured) & (sd < most_sd_px)
        if not is_measured.any():
            return None
        unmeasured = float(weight[~is_measured].sum())
        kept = index[is_measured]
        residual = placed.parallax_px[kept] - measured[is_measured]
        return _Terms(
            kept, by_point[is_measured], residual, sd[is_measured], weight[is_measured], unmeasured
        )

    pixels = placed.pixels[0][index]
    by_pair = _by_pair(seen, pixels, depth[index])
    by_maps = (each.at(pixels) for each in seen.by_maps)
    return [
        terms(*by_pair, TUNING.max_sd_px),
        *(terms(*each, float(WINDOW_PX**2), np.inf) for each in by_maps),
    ]


def _by_pair(
    seen: Seen, pixels: Float64Array, depth_mm: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array | float]:
    """(n,) parallax, (n,) its sd, and the area over which its errors are one, px."""
    if seen.surface is None:
        return _measured(seen, seen.dense, pixels, depth_mm)
    _, _, inward = _inward(seen, pixels)
    value, sd = seen.surface.at(pixels)
    return (
        np.where(inward > 1, value, np.nan),
        np.hypot(sd, TUNING.surface_sd_px),
        float(WINDOW_PX**2),
    )


def _measured(
    seen: Seen, dense: DisparityMap, pixels: Float64Array, depth_mm: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array | float]:
    """The same of a map of the whole grid, clear of the food's outline by the map's reach.

    A depth map shows the food itself, which departs from any form: of what one that is nearly exact says, the form's
    own error is what counts.
    """
    row, column, inward = _inward(seen, pixels)
    value = np.asarray(dense.parallax_px[row, column], np.float64)
    value = np.where(inward > dense.reach_px[row, column] + 1, value, np.nan)
    if dense.error_area_px is None or dense.sd_px is None:
        return value, np.full(len(value), TUNING.dense_sd_px), TUNING.dense_area_px
    noise = (
        np.nan_to_num(dense.sd_px[row, column].astype(np.float64)) ** 2
    )  # of what is not measured, none counts
    rough = (TUNING.roughness_mm * seen.sight.parallax_per_mm(depth_mm)) ** 2
    rough_px2 = (TUNING.roughness_run_mm * seen.sight.pair.focal_px / depth_mm) ** 2
    area_px = (noise * dense.error_area_px + rough * rough_px2) / (noise + rough)
    return value, np.sqrt(noise + rough), area_px


def _inward(seen: Seen, pixels: Float64Array) -> tuple[IntArray, IntArray, Float32Array]:
    """(n,) row and column of the nearest pixels of the grid, and how far these lie within the food's outline, px."""
    column, row = np.rint(pixels).astype(np.int64).T
    height, width = seen.mask.shape
    row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    return row, column, seen.inward_px[row, column]
