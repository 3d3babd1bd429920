import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.solids.families import MIN_POINTS, families
from app.vision.solids.forms import COARSE, EXACT, Ring

SUPPORT_MM, SUPPORT_SD_MM = 2.0, 0.5
CAMERA_MM = np.array([80.0, -320.0, 380.0])
MIDDLE_MM = np.array([80.0, 10.0])


def visible(half_mm, heading=0.0, count=4000, seed=0):
    """Points of an ellipsoid's camera side, and its mask's area."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine, sine = np.cos(heading), np.sin(heading)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    points = directions * half_mm @ turn.T + np.array([*MIDDLE_MM, SUPPORT_MM + half_mm[2]])
    outward = (directions / half_mm) @ turn.T
    seen = ((CAMERA_MM - points) * outward).sum(axis=1) > 0
    return points[seen] + rng.normal(0, 0.3, (np.count_nonzero(seen), 3)), float(np.pi * half_mm[0] * half_mm[1])


def begun(points, area_mm2, camera_mm=CAMERA_MM, support_mm=SUPPORT_MM):
    return families(points, area_mm2, support_mm, SUPPORT_SD_MM, camera_mm)


def spans(form):
    return np.ptp(form.vertices(form.start, COARSE), axis=0)


def volume(form):
    return enclosed_mm3(form.vertices(form.start, EXACT), form.topology(EXACT).faces)


def test_every_family_begins_near_the_food_on_its_support_and_only_the_ring_has_a_hole():
    forms = begun(*visible((30.0, 30.0, 28.0)))
    assert {"ball", "lying", "bent", "heap", "slab", "ring"} <= {form.name for form in forms}
    for form in forms:
        vertices = form.vertices(form.start, COARSE)
        assert np.isclose(vertices[:, 2].min(), SUPPORT_MM, atol=0.5)
        assert np.linalg.norm((vertices.min(axis=0) + vertices.max(axis=0))[:2] / 2 - MIDDLE_MM) < 20
        assert 20 < np.ptp(vertices[:, 2]) < 80
        mesh = form.topology(COARSE)
        holes = 1 - (len(mesh.places) - len(mesh.edges) + len(mesh.faces)) // 2
        assert holes == (1 if isinstance(form, Ring) else 0)


@pytest.mark.parametrize("heading", [0.0, 0.6, 2.5])
def test_lying_form_begins_along_the_food(heading):
    forms = begun(*visible((50.0, 20.0, 18.0), heading))
    lying = next(form for form in forms if form.name == "lying")
    direction = lying.axes[:, 2]
    assert abs(direction @ [np.cos(heading), np.sin(heading), 0.0]) > 0.95
    assert np.isclose(np.linalg.det(lying.axes), 1.0)


def test_ball_begins_with_about_the_size_of_what_is_seen_and_bent_forms_to_both_sides():
    half = np.array([32.0, 32.0, 25.0])
    ball = next(form for form in begun(*visible(half)) if form.name == "ball")
    assert np.allclose(spans(ball), 2 * half, rtol=0.2)
    bent = [form for form in begun(*visible((50.0, 20.0, 18.0))) if form.name == "bent"]
    assert len(bent) == 2
    assert np.isclose(volume(bent[0]), volume(bent[1]), rtol=1e-3)


@pytest.mark.parametrize(("count", "lowered_mm"), [(0, 0.0), (MIN_POINTS - 1, 0.0), (None, 100.0)])
def test_few_points_and_points_under_the_support_begin_nothing(count, lowered_mm):
    points, area_mm2 = visible((30.0, 30.0, 28.0))
    assert begun((points - np.array([0.0, 0.0, lowered_mm]))[:count], area_mm2) == []
