"""Forms of known volume, and the derivatives that fitting rests on against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import beta

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.solids.forms import (
    BEND,
    COARSE,
    E1,
    E2,
    EXACT,
    FINE,
    ROUND_SD,
    SUNK,
    SUPPORT,
    TAPER,
    TURN_X,
    TURN_Y,
    TURN_Z,
    A,
    B,
    C,
    Ring,
    Superellipsoid,
    X,
    Y,
)
from app.vision.tuning import TUNING
from tests.unit.vision.meshes import jacobian_of

SUPPORT_MM, SUPPORT_SD_MM = 2.5, 1.0
PLACE = (X, Y, SUPPORT, A, B, C, E1, E2, TURN_X, TURN_Y, TURN_Z)
LYING = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def parameters(a, b, c, **values):
    p = np.zeros(14)
    p[[X, Y, SUPPORT, A, B, C]] = 40.0, -15.0, SUPPORT_MM, np.log(a), np.log(b), np.log(c)
    places = {"e1": E1, "e2": E2, "taper": TAPER, "bend": BEND, "sunk": SUNK, "turn_x": TURN_X, "turn_y": TURN_Y}
    for key, value in values.items():
        p[places[key]] = value
    return p


def superellipsoid(p, free=PLACE, axes=None):
    return Superellipsoid("form", p, free, np.eye(3) if axes is None else axes, SUPPORT_SD_MM)


def heap(p):
    return superellipsoid(p, (X, Y, SUPPORT, SUNK, A, B, C, E1, E2, TURN_Z))


FORMS = {
    "ball": superellipsoid(parameters(30.0, 25.0, 20.0, e1=-0.2, turn_x=0.2), (*PLACE, TAPER)),
    "lying": superellipsoid(parameters(15.0, 18.0, 50.0, taper=0.1), (*PLACE, TAPER), LYING),
    "bent": superellipsoid(parameters(15.0, 18.0, 60.0, bend=0.6), (*PLACE, TAPER, BEND), LYING),
    "heap": heap(parameters(40.0, 30.0, 25.0, sunk=20.0)),
    "slab": superellipsoid(parameters(40.0, 30.0, 10.0, e1=-1.2, e2=-1.2, turn_x=0.05, turn_y=0.03)),
    "ring": Ring(
        "ring",
        parameters(30.0, 12.0, 10.0, e1=0.1, turn_x=0.05),
        (X, Y, SUPPORT, A, B, C, E1, TURN_X, TURN_Y, TURN_Z),
        np.eye(3),
        SUPPORT_SD_MM,
    ),
}
every_form = pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())


def volume(form, unknowns=None, cells=EXACT):
    vertices = form.vertices(form.start if unknowns is None else unknowns, cells)
    return enclosed_mm3(vertices, form.topology(cells).faces)


@pytest.mark.parametrize(
    ("form", "truth_mm3", "tolerance"),
    [
        # The mesh's vertices lie on the form: it is smaller by what a triangle cuts off.
        (superellipsoid(parameters(30.0, 25.0, 20.0)), 4 / 3 * np.pi * 30 * 25 * 20, 0.006),
        (superellipsoid(parameters(30.0, 25.0, 20.0), axes=LYING), 4 / 3 * np.pi * 30 * 25 * 20, 0.006),
        (superellipsoid(parameters(20.0, 20.0, 50.0, bend=0.7), axes=LYING), 4 / 3 * np.pi * 20 * 20 * 50, 0.01),
        (replace(FORMS["ring"], parameters=parameters(30.0, 12.0, 10.0)), 2 * np.pi**2 * 30 * 12 * 10, 0.006),
        (replace(FORMS["ring"], parameters=parameters(30.0, 12.0, 10.0, e1=0.3)), 2 * np.pi**2 * 30 * 12 * 10, 0.006),
    ],
    ids=["ellipsoid", "lying ellipsoid", "bent about its middle line", "ring", "stretched ring"],
)
def test_form_has_its_volume(form, truth_mm3, tolerance):
    assert np.isclose(volume(form), truth_mm3, rtol=tolerance)


@pytest.mark.parametrize(("e1", "e2"), [(0.1, 0.1), (0.3, 0.6), (0.5, 1.0), (1.4, 1.0)])
def test_superellipsoid_has_the_volume_of_its_exponents(e1, e2):
    form = superellipsoid(parameters(30.0, 25.0, 20.0, e1=np.log(e1), e2=np.log(e2)))
    truth = 2 * 30 * 25 * 20 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2)  # Jaklic et al. (2000), eq. 2.60
    assert np.isclose(volume(form), truth, rtol=0.01)


@pytest.mark.parametrize("sunk_mm", [10.0, 20.0, 30.0, 38.0])
def test_heap_is_the_cap_above_its_foot(sunk_mm):
    radius = 20.0
    form = heap(parameters(radius, radius, radius, sunk=sunk_mm))
    high = 2 * radius - sunk_mm
    assert np.isclose(volume(form), np.pi * high**2 * (3 * radius - high) / 3, rtol=0.012)
    vertices = form.vertices(form.start, EXACT)
    assert np.isclose(np.ptp(vertices[:, 2]), high, rtol=1e-3)
    on_support = vertices[np.isclose(vertices[:, 2], vertices[:, 2].min(), atol=1e-9)]
    foot = np.linalg.norm(on_support[:, :2] - [40.0, -15.0], axis=1).max()
    assert np.isclose(foot, np.sqrt(radius**2 - (sunk_mm - radius) ** 2), rtol=1e-6)


@every_form
def test_form_rests_on_its_support_which_lifts_it_without_changing_it(form):
    rng = np.random.default_rng(2)
    for weights in (np.zeros(len(form.weight_sd)), rng.normal(0, form.weight_sd)):
        unknowns = form.start
        unknowns[len(form.free) :] = weights
        assert SUPPORT_MM - 2 * TUNING.contact_mm < form.vertices(unknowns, FINE)[:, 2].min() <= SUPPORT_MM
    raised = form.start
    raised[form.free.index(SUPPORT)] += 7.0
    assert np.allclose(form.vertices(raised, COARSE) - form.vertices(form.start, COARSE), [0, 0, 7.0])
    raised[form.free.index(SUPPORT)] += 43.0
    bounded, _ = form.split(form.bounded(raised))
    assert SUPPORT_MM < bounded[SUPPORT] <= SUPPORT_MM + 3 * SUPPORT_SD_MM


def test_taper_and_bend_keep_the_middle_section_and_the_length_along_the_axis():
    plain = superellipsoid(parameters(15.0, 15.0, 50.0))
    middle = np.isclose(plain.topology(FINE).places[:, 2], 0)
    for shape in ({"taper": 0.2}, {"bend": 1e-3}):
        changed = superellipsoid(parameters(15.0, 15.0, 50.0, **shape))
        before, after = (form.vertices(form.start, FINE) for form in (plain, changed))
        assert np.allclose(before[middle], after[middle], atol=1e-3)
        assert np.isclose(np.ptp(before[:, 2]), np.ptp(after[:, 2]), rtol=1e-3)


@every_form
@pytest.mark.parametrize(
    ("displaced", "tolerance"),
    [(0.0, 0.03), (1.0, 0.03)],
    ids=["plain", "displaced"],
)
def test_jacobian_is_that_of_central_differences(form, displaced, tolerance):
    unknowns = form.start
    unknowns[len(form.free) :] = displaced * np.random.default_rng(3).normal(0, form.weight_sd)
    jacobian = jacobian_of(form, unknowns, FINE)
    for row in range(len(unknowns)):
        step = 1e-4
        there, back = unknowns.copy(), unknowns.copy()
        there[row] += step
        back[row] -= step
        truth = (form.vertices(there, FINE) - form.vertices(back, FINE)) / (2 * step)
        off = np.abs(jacobian[row] - truth).mean()
        assert off <= tolerance * np.abs(truth).mean() + 1e-3, row
    some = np.array([40, 3, 3, 17])
    assert np.allclose(jacobian_of(form, unknowns, FINE, some), jacobian[:, some])


@every_form
def test_all_vectors_have_one_length_and_without_weights_nothing_is_displaced(form):
    bare = replace(form, has_displacement=False)
    assert len(bare.start) == len(form.free)
    assert len(form.start) == len(form.expected) == len(form.stride) == len(form.free) + len(form.weight_sd)
    assert np.allclose(form.bounded(form.start), form.start)
    assert np.allclose(form.vertices(form.start, COARSE), bare.vertices(bare.start, COARSE))


@every_form
def test_prior_is_least_where_it_is_expected_and_its_determinant_is_over_what_is_bound(form):
    precision = form.prior_precision
    values = np.linalg.eigvalsh(precision)
    bound = values > 1e-9
    assert (values > -1e-9).all()
    assert np.isclose(np.log(values[bound]).sum(), form.prior_log_determinant)
    apart = form.start - form.expected
    assert apart @ precision @ apart >= 0


def test_round_section_is_dear_to_flatten_and_free_to_grow():
    form = replace(FORMS["ball"], is_round=True)
    free, precision = list(form.free), form.prior_precision
    flatter, larger = np.zeros(len(form.start)), np.zeros(len(form.start))
    flatter[[free.index(A), free.index(B)]] = ROUND_SD / 2, -ROUND_SD / 2
    larger[[free.index(A), free.index(B)]] = 1.0
    assert np.isclose(flatter @ precision @ flatter, 1.0)
    assert np.isclose(larger @ precision @ larger, 0.0)
    section = form.expected[[free.index(A), free.index(B)]]
    assert section[0] == section[1]
