"""The default method on rendered meals: the same photographs in another form give the same volumes.

Volumes are compared with those of the pair as it is, not with the truth, which benchmarks/accuracy.py is for.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from app.vision.model import PhotoPair
from tests.support.scenes import as_jpeg, both, lit, load_scene, right_only, rolled, scaled, zoomed

STABLE = 0.03  # what another file of the same pair may change
PHONES = 0.08  # other pixels, noise or light: about the interval's half width
# Priors in mm (sizes of dishes and foods, bends of sheets) weigh otherwise for a world twice as large. Differences go
# up to 2.9 % (apple-1) and 3.8 % (pear-1) on some processors and stay under 2.5 % on others.
SCALED = 0.05
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene(shared_data):
    cv2.setNumThreads(1)
    return cache(lambda name: load_scene(shared_data, name))


@pytest.fixture(scope="module")
def as_it_is(scene):
    return cache(lambda name: volumes_ml(scene(name).estimate()))


def volumes_ml(estimate):
    assert estimate.failure is None, estimate.failure
    return np.sort([item.volume_ml for item in estimate.items])


def assert_same(estimate, expected_ml, tolerance):
    found = volumes_ml(estimate)
    assert len(found) == len(expected_ml)
    assert np.abs(found / expected_ml - 1).max() < tolerance, found / expected_ml - 1


def encoded_again(scene):
    return scene.estimate(both(scene.pair, as_jpeg(75)))


def halved(scene):
    return scene.estimate(both(scene.pair, scaled(0.5)))


def swapped(scene):
    return scene.estimate(PhotoPair(scene.pair.right, scene.pair.left))


def phone_rolled(scene):
    pair, camera = rolled(scene, 20.0)
    return scene.estimate(pair, camera=camera)


def portrait(scene):
    return scene.estimate(both(scene.pair, np.rot90))


def small(scene):
    factor = np.sqrt(2e6 / (scene.camera.width * scene.camera.height))
    return scene.estimate(both(both(scene.pair, scaled(float(factor))), as_jpeg(60)))


def darker(scene):
    return scene.estimate(right_only(scene.pair, lit(0.6, 0.6, 0.6)))


def other_white_balance(scene):
    return scene.estimate(right_only(scene.pair, lit(0.82, 1.0, 1.18)))


def zoomed_with_exif_alone(scene):
    return scene.estimate_by_exif(zoomed(scene.pair, 1.15))


FRUITS, ALL = ("apple-1", "pear-1"), ("apple-1", "pear-1", "meal-01")
FORMS = [  # without meal-01 where its pale egg or the hidden foot of its salad comes out 3 to 10 % otherwise
    (encoded_again, STABLE, FRUITS),
    (halved, STABLE, FRUITS),
    (swapped, STABLE, ALL),
    (phone_rolled, PHONES, FRUITS),
    (portrait, PHONES, ALL),
    (small, PHONES, ALL),
    (darker, PHONES, ALL),
    (other_white_balance, PHONES, ALL),
    (zoomed_with_exif_alone, PHONES, ALL),
]


@pytest.mark.parametrize(
    ("form", "tolerance", "name"), [(form, tolerance, name) for form, tolerance, names in FORMS for name in names]
)
def test_same_photographs_in_another_form_give_the_same_volumes(scene, as_it_is, form, tolerance, name):
    assert_same(form(scene(name)), as_it_is(name), tolerance)


@pytest.mark.parametrize("name", FRUITS)  # what plates are like is known in mm, not in sizes of the marker
def test_marker_declared_twice_as_large_gives_eight_times_the_volume(scene, as_it_is, name):
    each = scene(name)
    twice = replace(each.spec, square_mm=2 * each.spec.square_mm)
    assert_same(each.estimate(spec=twice), 8 * as_it_is(name), SCALED)
