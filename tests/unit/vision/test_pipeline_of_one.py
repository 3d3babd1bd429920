"""One photograph: the same ball with a wider interval; and a pair that is measured by its left photograph alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from app.vision.board.marker import find_marker
from app.vision.model import EstimateOptions, Hint, LikelyFood, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.scene.segmentation import Region
from app.vision.solids.measured_item import MeasuredItem, of_single_view
from app.vision.views.single_view import place_alone, single_volume_sd
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, covered, on_plain_table

OPTIONS = EstimateOptions(SPEC, CAMERA)
TOLERANCE = (
    0.3  # one outline, which a ball, a slab and a heap explain alike: the mean of their volumes is a quarter less
)


def measured(pair, **options):
    return estimate_meal(PhotoPair(on_plain_table(pair.left)), replace(OPTIONS, **options)).items


def test_ball_of_one_photograph_has_its_volume_within_a_wide_interval(single):
    assert single.failure is None
    [item] = single.items
    assert "single_view" in item.flags
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    low, high = item.volume_interval_ml
    assert low < BALL.volume_ml < high
    assert high / low > 1.2
    assert single.parameters["views"] == 1
    assert single.views[1] is None
    assert {"overlay.jpg", "scene.json"} <= {each.name for each in single.artefacts}


def hint_of(single, **facts):
    """A hint in the middle of the ball."""
    [ring] = single.items[0].rings
    x, y = ring.mean(axis=0)
    return Hint(point=(float(x), float(y)), **facts)


@pytest.mark.slow
def test_form_that_a_person_names_decides_against_outline_and_candidates(pair, single):
    whole, heap, contradicted = (
        measured(pair, hints=(hint_of(single, form=form),), foods_by_looks=candidates)
        for form, candidates in (("whole", None), ("heap", None), ("whole", lambda _: [LikelyFood("heap", 1.0)]))
    )
    assert contradicted[0].volume_ml == whole[0].volume_ml
    heap_ml, whole_ml = (next(item.volume_ml for item in items if item.hint == 0) for items in (heap, whole))
    assert heap_ml < whole_ml


@pytest.mark.slow
def test_marker_unseen_in_the_right_photograph_leaves_the_left_one(pair, single, views):
    hidden = covered(views[1]).photo
    alone = estimate_meal(PhotoPair(on_plain_table(pair.left), hidden), OPTIONS)
    assert [item.volume_ml for item in alone.items] == [item.volume_ml for item in single.items]


def test_marker_unseen_in_the_left_photograph_or_by_the_papers_method_in_either_is_told(pair, views):
    left, right = (covered(view).photo for view in views)
    assert estimate_meal(PhotoPair(left, pair.right), OPTIONS).failure.code == "marker_not_found"
    paper = estimate_meal(PhotoPair(pair.left, right), replace(OPTIONS, method="paper"))
    assert paper.failure.code == "marker_not_found"


HELD = [Hint(form="liquid"), Hint(lies_as="in_vessel"), Hint(usual_form="in_vessel"), Hint(vessel="mug")]


def test_volume_in_a_vessel_is_not_given():
    item = MeasuredItem(Region(np.zeros((1, 1), np.bool_), None), np.empty((0, 3)), 0.0, SimpleNamespace(), ())
    assert of_single_view(item, None).volume is not None
    assert of_single_view(item, Hint(form="heap")).volume is not None
    for hint in HELD:
        unknown = of_single_view(item, hint)
        assert unknown.volume is None
        assert unknown.flags == ("single_view", "not_measurable")


def test_pose_of_one_view_doubts_a_volume_far_from_the_marker_more(pair):
    view = place_alone(pair.left, find_marker(pair.left, SPEC), OPTIONS)
    near, far = (single_volume_sd(view, np.array([x, 0.0])) for x in (60.0, 300.0))
    assert 0.0 < near < far < 0.2
    free = place_alone(pair.left, find_marker(pair.left, SPEC), replace(OPTIONS, camera=None))
    assert single_volume_sd(free, np.array([60.0, 0.0])) > near
