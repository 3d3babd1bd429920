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
SCENES = ("apple-1", "pear-1", "meal-01")
pytestmark = pytest.mark.slow


def but_for_meal_01(reason):
    """The scenes; meal-01 may miss the bar: figures near it differ between processors."""
    mark = pytest.mark.xfail(strict=False, reason=reason)
    return [pytest.param(name, marks=mark) if name == "meal-01" else name for name in SCENES]


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


@pytest.mark.parametrize("name", but_for_meal_01("its egg, pale on a pale plate, comes out 3.5 % larger"))
def test_encoded_again_at_quality_75(scene, as_it_is, name):
    each = scene(name)
    assert_same(each.estimate(both(each.pair, as_jpeg(75))), as_it_is(name), STABLE)


@pytest.mark.parametrize("name", but_for_meal_01("its salad's hidden foot comes out 6 % smaller from half the pixels"))
def test_halved_in_size(scene, as_it_is, name):
    each = scene(name)
    assert_same(each.estimate(both(each.pair, scaled(0.5))), as_it_is(name), STABLE)


@pytest.mark.parametrize("name", SCENES)
def test_left_and_right_swapped(scene, as_it_is, name):
    each = scene(name)
    assert_same(each.estimate(PhotoPair(each.pair.right, each.pair.left)), as_it_is(name), STABLE)


@pytest.mark.parametrize("name", but_for_meal_01("what plates are like is known in mm, not in sizes of the marker"))
def test_marker_declared_twice_as_large_gives_eight_times_the_volume(scene, as_it_is, name):
    each = scene(name)
    twice = replace(each.spec, square_mm=2 * each.spec.square_mm)
    assert_same(each.estimate(spec=twice), 8 * as_it_is(name), SCALED)


@pytest.mark.parametrize("name", but_for_meal_01("its salad's hidden foot comes out 10 % larger"))
def test_phone_rolled_by_20_degrees(scene, as_it_is, name):
    pair, camera = rolled(scene(name), 20.0)
    assert_same(scene(name).estimate(pair, camera=camera), as_it_is(name), PHONES)


@pytest.mark.parametrize("name", SCENES)
def test_portrait(scene, as_it_is, name):
    each = scene(name)
    assert_same(each.estimate(both(each.pair, np.rot90)), as_it_is(name), PHONES)


@pytest.mark.parametrize("name", SCENES)
def test_small_photographs_at_quality_60(scene, as_it_is, name):
    each = scene(name)
    factor = np.sqrt(2e6 / (each.camera.width * each.camera.height))
    pair = both(both(each.pair, scaled(float(factor))), as_jpeg(60))
    assert_same(each.estimate(pair), as_it_is(name), PHONES)


@pytest.mark.parametrize("light", [(0.6, 0.6, 0.6), (0.82, 1.0, 1.18)], ids=["darker", "white balance"])
@pytest.mark.parametrize("name", SCENES)
def test_one_photograph_in_another_light(scene, as_it_is, name, light):
    each = scene(name)
    assert_same(each.estimate(right_only(each.pair, lit(*light))), as_it_is(name), PHONES)


@pytest.mark.parametrize("name", SCENES)
def test_one_photograph_zoomed_with_exif_alone(scene, as_it_is, name):
    each = scene(name)
    assert_same(each.estimate_by_exif(zoomed(each.pair, 1.15)), as_it_is(name), PHONES)
