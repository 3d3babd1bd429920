"""Forms fitted to evidence that is made from a known surface, without images: its exact outlines and parallax."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from app.vision.geometry.masks import filled
from app.vision.geometry.mesh import faces_towards, ring, sphere
from app.vision.solids.families import _RING, _UPRIGHT
from app.vision.solids.form_average import likely_fits
from app.vision.solids.form_fit import fit_form, form_at
from app.vision.solids.forms import COARSE, FINE, SUPPORT, A, B, C, Ring, Superellipsoid, X, Y
from app.vision.solids.outline_snap import Nearest, outline, rings_of_mask
from app.vision.solids.outline_snap import Ring as Line
from app.vision.solids.seen import Seen
from app.vision.solids.surface_match import SurfaceParallax, draw_mask, draw_parallax
from app.vision.tuning import TUNING
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import rectify_by_poses
from app.vision.views.sight import Sight
from tests.unit.vision.stereo_scene import blank_views

SIGHT = Sight(rectify_by_poses(*blank_views()))
SHAPE = SIGHT.pair.shape
SUPPORT_MM, SUPPORT_SD_MM = 2.0, 0.5
MIDDLE_MM = np.array([60.0, 5.0])
FINER = 6


def ellipsoid(half_mm, heading=0.0):
    cosine, sine = np.cos(heading), np.sin(heading)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    mesh = sphere(30)
    return mesh.places * half_mm @ turn.T + np.array([*MIDDLE_MM, SUPPORT_MM + half_mm[2]]), mesh


def torus(middle_mm=32.0, tube_mm=13.0):
    mesh = ring(90, 40)
    turn, tube = mesh.places.T
    radius = middle_mm + tube_mm * np.cos(tube)
    own = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), tube_mm * np.sin(tube)])
    return own + np.array([*MIDDLE_MM, SUPPORT_MM + tube_mm]), mesh


def lines_of(vertices, mesh, view):
    """The outline in a view, from a mask drawn FINER times as large: to a tenth of a pixel."""
    faces = mesh.faces[faces_towards(vertices, mesh.faces, SIGHT.cameras_mm[view])]
    return line_of_pixels(SIGHT.in_view(*SIGHT.project(vertices), view), faces)


def line_of_pixels(pixels, faces):
    """The outline of what triangles with corners at these pixels cover."""
    low = np.floor(pixels.min(axis=0)) - 4
    width, height = (np.ceil(np.ptp(pixels, axis=0)).astype(int) + 8) * FINER
    mask = draw_mask((pixels - low + 0.5) * FINER - 0.5, faces, (height, width))
    rings = [
        Line((each.points_px[::FINER] + 0.5) / FINER - 0.5 + low, each.normals[::FINER]) for each in rings_of_mask(mask)
    ]
    return outline(rings, np.ones(sum(len(each.points_px) for each in rings)))


@lru_cache
def seen_of(solid=(30.0, 30.0, 30.0), heading=0.0, *, noise_px=0.1, is_along=True, seed=0):
    """What both views show of an ellipsoid with these half-axes, mm, or of the torus."""
    return seen_of_mesh(
        *(torus() if solid == "torus" else ellipsoid(solid, heading)), noise_px, seed, is_along=is_along
    )


def seen_of_mesh(vertices, mesh, noise_px=0.1, seed=0, *, is_along=True):
    """What both views show of a closed surface."""
    drawn, (left, top) = draw_parallax(SIGHT, vertices, mesh, SHAPE)
    parallax = np.full(SHAPE, np.nan, np.float32)
    parallax[top : top + drawn.shape[0], left : left + drawn.shape[1]] = drawn
    mask = np.isfinite(parallax)
    parallax += np.random.default_rng(seed).normal(0, noise_px, SHAPE).astype(np.float32)
    return Seen(
        sight=SIGHT,
        mask=mask,
        inward_px=np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32),
        outlines=(lines_of(vertices, mesh, 0), lines_of(vertices, mesh, 1)),
        dense=DisparityMap(parallax, np.full(SHAPE, 4.5, np.float32)),
        surface=SurfaceParallax(parallax, np.full(SHAPE, 0.1, np.float32), (0, 0)) if is_along else None,
    )


def ball(half_mm=(25.0, 25.0, 25.0), off_mm=(6.0, -5.0), **changes):
    p = np.zeros(14)
    p[[X, Y]], p[SUPPORT], p[[A, B, C]] = MIDDLE_MM + off_mm, SUPPORT_MM, np.log(half_mm)
    return replace(Superellipsoid("ball", p, _UPRIGHT, np.eye(3), SUPPORT_SD_MM), **changes)


def flat_ring():
    p = np.zeros(14)
    p[[X, Y]], p[SUPPORT], p[[A, B, C]] = MIDDLE_MM + 3.0, SUPPORT_MM, np.log([28.0, 15.0, 15.0])
    return Ring("ring", p, _RING, np.eye(3), SUPPORT_SD_MM)


every_ellipsoid = pytest.mark.parametrize(
    ("half_mm", "heading"),
    [((30.0, 30.0, 30.0), 0.0), ((38.0, 27.0, 22.0), 0.3), ((25.0, 25.0, 35.0), 0.0)],
    ids=["ball", "ellipsoid", "egg"],
)


def volume_ml(half_mm):
    return 4 / 3 * np.pi * float(np.prod(half_mm)) / 1000


@every_ellipsoid
def test_ellipsoid_has_its_volume_from_outlines_and_parallax(half_mm, heading):
    seen = seen_of(half_mm, heading)
    begun = 0.85 * np.array(half_mm)
    plain = fit_form(ball(begun, has_displacement=False), seen, FINE)
    assert np.isclose(plain.volume_ml, volume_ml(half_mm), rtol=0.015)
    start = ball(begun).start
    start[: len(_UPRIGHT)] = plain.unknowns
    free = fit_form(ball(begun), seen, FINE, start)
    # What no view shows, the displacement may move: its prior alone holds it.
    assert np.isclose(free.volume_ml, volume_ml(half_mm), rtol=0.03)
    assert abs(free.volume_ml - volume_ml(half_mm)) < 2 * free.volume_sd_ml
    assert free.volume_sd_ml > plain.volume_sd_ml


def test_too_small_parallax_of_the_middle_does_not_flatten_a_ball_along_the_line_of_sight():
    """A flat form tilted towards the cameras has the same outlines, but food does not rest like that."""
    seen = seen_of()
    far = np.where(seen.inward_px > 25, seen.dense.parallax_px - np.float32(1.0), np.float32(np.nan))
    sd = np.full(SHAPE, 0.4, np.float32)
    nothing = DisparityMap(np.full(SHAPE, np.nan, np.float32), seen.dense.reach_px)
    seen = replace(seen, dense=nothing, surface=SurfaceParallax(far, sd, (0, 0)))
    fit = fit_form(ball((30.0, 30.0, 30.0), has_displacement=False), seen, FINE)
    assert np.isclose(fit.volume_ml, volume_ml((30.0, 30.0, 30.0)), rtol=0.02)


def test_ring_has_its_volume_and_explains_a_ring_better_than_a_ball():
    seen, form = seen_of("torus"), replace(flat_ring(), has_displacement=False)
    assert np.isclose(fit_form(form, seen, FINE).volume_ml, 2 * np.pi**2 * 32 * 13**2 / 1000, rtol=0.015)
    as_ball = fit_form(ball((40.0, 40.0, 13.0), has_displacement=False), seen, COARSE)
    assert as_ball.cost > 2 * fit_form(form, seen, COARSE).cost


def test_strayed_parallax_and_outline_hardly_change_the_volume():
    seen = seen_of()
    parallax = seen.surface.parallax_px.copy()
    y, x = np.argwhere(seen.mask).mean(axis=0).astype(int)
    parallax[y - 60 : y - 35, x - 12 : x + 12] += 3.0  # a highlight: 25 sd
    line = seen.outlines[0]
    points = line.points_px.copy()
    points[: len(points) // 12] += 8.0 * line.normals[: len(points) // 12]  # a shadow taken for food
    strayed = replace(
        seen,
        surface=replace(seen.surface, parallax_px=parallax),
        outlines=(replace(line, points_px=points, nearest=Nearest(points)), seen.outlines[1]),
    )
    fit = fit_form(ball(has_displacement=False), strayed, FINE)
    assert np.isclose(fit.volume_ml, volume_ml((30.0, 30.0, 30.0)), rtol=0.03)


def test_fit_that_begins_out_of_the_outlines_reach_is_drawn_in():
    half_mm = (44.0, 20.0, 18.0)
    turned_away = ball((40.0, 15.0, 16.0), off_mm=(22.0, 14.0), has_displacement=False)
    fit = fit_form(turned_away, seen_of(half_mm, 1.4, is_along=False), COARSE)
    assert np.isclose(fit.volume_ml, volume_ml(half_mm), rtol=0.02)


@pytest.mark.parametrize("cells", [COARSE, FINE])
def test_cost_changes_by_no_leap_along_a_way_that_turns_and_grows(cells):
    """From place to place other vertices lie on the outline, face the camera and rest on the support."""
    form, seen = ball((30.0, 26.0, 24.0), off_mm=(0.0, 0.0)), seen_of((30.0, 26.0, 24.0))
    way = np.zeros(len(form.start))
    way[[3, 8, 9, 10, 20, 30]] = 0.1, 0.2, -0.2, 0.1, 0.03, -0.02
    costs = np.array([form_at(form, form.start + share * way, cells, seen).cost() for share in np.linspace(0, 1, 401)])
    assert np.abs(np.diff(costs, 2)).max() < 0.02 * np.ptp(costs)


def test_volumes_of_perturbed_starts_agree():
    half_mm = (38.0, 27.0, 22.0)
    seen, drawn = seen_of(half_mm, 0.3), np.random.default_rng(1)
    volumes = []
    for _ in range(8):
        off_mm, factors = drawn.normal(0, 3, 2), np.exp(drawn.normal(0, 0.1, 3))
        begun = ball(factors * half_mm, off_mm=off_mm, has_displacement=False)
        volumes.append(fit_form(begun, seen, FINE).volume_ml)
    assert max(volumes) / min(volumes) < 1.005


def test_form_that_shows_nothing_of_the_food_is_no_fit():
    seen = seen_of()
    unseen = np.full(SHAPE, np.nan, np.float32)
    blind = replace(seen, outlines=(None, None), surface=SurfaceParallax(unseen, unseen, (0, 0)))
    assert fit_form(ball(), blind, COARSE) is None


def test_family_of_no_weight_is_fitted_no_further():
    seen = seen_of((40.0, 30.0, 13.0))
    forms = ball((38.0, 28.0, 12.0), off_mm=(2.0, 1.0), has_displacement=False), flat_ring()
    near, far = (fit_form(form, seen, COARSE) for form in forms)
    assert likely_fits([near, far]) == [near]
    assert likely_fits([near, far], ["ring"]) == [near, far]
    assert likely_fits([near, near]) == [near, near]
    assert likely_fits([]) == []


def test_part_of_the_mask_left_out_counts_against_a_form():
    """Where another food hides the outline, a banana along the rest of it leaves half of a cake uncovered."""
    seen = seen_of((40.0, 30.0, 13.0))
    fit = fit_form(ball((38.0, 28.0, 12.0), has_displacement=False), seen, FINE)
    rows, columns = np.nonzero(seen.mask)
    beside = np.zeros_like(seen.mask)
    beside[rows.min() - 20 : rows.min(), columns.min() : columns.max()] = True
    half_seen = fit_form(fit.form, replace(seen, mask=seen.mask | beside), FINE, fit.unknowns, most_rounds=0)
    more = np.count_nonzero(beside) / TUNING.dense_area_px
    assert fit.uncovered < 1.0
    assert half_seen.uncovered == pytest.approx(fit.uncovered + more)
    assert half_seen.evidence == pytest.approx(fit.evidence + TUNING.unexplained_loss * more)


def test_hole_of_a_ring_is_not_left_out():
    seen = seen_of("torus")
    fit = fit_form(flat_ring(), replace(seen, mask=filled(seen.mask)), FINE)
    assert fit.form.name == "ring"
    assert fit.uncovered < 2.0
