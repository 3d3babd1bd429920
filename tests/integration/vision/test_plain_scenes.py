"""Pairs of plain foods on plain tables, where hardly a point is matched: the marker alone places the cameras."""

import cv2
import numpy as np
import pytest

from app.vision.model import EstimateOptions, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.views import features
from tests.support.scenes import load_scene, with_food_moved

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def hardly_any_features(monkeypatch):
    """Make SIFT see edges alone and leave no corners to follow, as if the scene had no texture."""
    cv2.setNumThreads(1)
    monkeypatch.setattr(features, "MIN_CONTRASTS", (0.3,))
    monkeypatch.setattr(features, "corners_of", lambda *_: np.empty((0, 2)))


@pytest.mark.parametrize("name", ["apple-1", "orange-1", "kiwi-1"])
def test_plain_meal_is_measured_by_its_marker_alone(shared_data, name):
    scene = load_scene(shared_data, name)
    estimate = scene.estimate()
    assert estimate.failure is None
    [item] = estimate.items
    low, high = item.volume_interval_ml
    truth = scene.truth["items"][0]["volume_ml"]
    assert low < truth < high
    assert item.volume_ml == pytest.approx(truth, rel=0.08)
    assert "few_matches" in item.flags
    assert estimate.parameters["pose_matches"] == 0


def test_method_that_needs_matches_measures_nothing_by_the_marker_alone(shared_data):
    scene = load_scene(shared_data, "apple-1")
    estimate = estimate_meal(scene.pair, EstimateOptions(scene.spec, scene.camera, method="paper-strict"))
    assert estimate.failure.code == "too_few_matches"
    assert estimate.items == ()


@pytest.mark.parametrize("names", [("meal-04", "hard-02-pale"), ("apple-1", "pear-1")])
def test_photographs_of_two_plain_meals_are_not_measured(shared_data, names):
    left, right = (load_scene(shared_data, name) for name in names)
    pair = PhotoPair(left.pair.left, right.pair.right)
    estimate = estimate_meal(pair, EstimateOptions(left.spec, left.camera), want_artefacts=True)
    assert estimate.failure.code == "too_few_matches"
    assert estimate.failure.advice
    assert estimate.items == ()
    assert "slices.jpg" not in {artefact.name for artefact in estimate.artefacts}


@pytest.mark.parametrize("move", [(0, 8), (0, 20), (20, 0), (-20, 0)])
def test_plain_food_pushed_between_the_photographs_is_not_measured(shared_data, move):
    scene = load_scene(shared_data, "kiwi-1")
    estimate = scene.estimate(with_food_moved(scene, *move))
    assert estimate.failure.code == "too_few_matches"
    assert estimate.items == ()
