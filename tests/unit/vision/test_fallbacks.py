"""What is measured instead where a run fails, with steps that fail as told."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.fallbacks import run_with_fallbacks
from app.vision.known_poses import poses_from_mapping
from app.vision.model import DepthMap, EstimateOptions, ItemEstimate, PhotoPair
from app.vision.stages import Stages
from tests.unit.vision.poses import arkit_poses
from tests.unit.vision.stereo_scene import CAMERA, SPEC, blank_views

VIEWS = blank_views()
LEFT, RIGHT = (view.photo for view in VIEWS)
DEEP = replace(LEFT, depth=DepthMap(np.ones((4, 4), np.float32), 4.0, 4.0, 2.0, 2.0, 0.01, 1.0))
BY_MARKER = EstimateOptions(SPEC, CAMERA)
WITH_POSES = replace(BY_MARKER, poses=poses_from_mapping(arkit_poses(*VIEWS)))
FOOD = ItemEstimate((), 100.0, (90.0, 110.0), {})


def inputs(pair, options):
    """Which photographs and which source a run measures."""
    photographs = "pair" if pair.right is not None else "left"
    return photographs, "marker" if options.marker is not None else "poses"


@pytest.mark.parametrize(
    ("left", "options", "code", "tried"),
    [
        (LEFT, BY_MARKER, "scene_moved", [("pair", "marker")]),
        (DEEP, BY_MARKER, "scene_moved", [("pair", "marker"), ("left", "marker")]),
        (DEEP, BY_MARKER, "marker_not_found", [("pair", "marker")]),
        (LEFT, WITH_POSES, "marker_covered", [("pair", "marker"), ("pair", "poses"), ("left", "marker")]),
        (LEFT, WITH_POSES, "no_food_found", [("pair", "marker")]),
    ],
)
def test_fallbacks_follow_the_failure_and_the_last_that_succeeds_counts(left, options, code, tried):
    pair, runs = PhotoPair(left, RIGHT), []

    def steps(pair, options, trace, *, last=None):
        runs.append(inputs(pair, options))
        trace.markers = VIEWS[0].marker, None  # the left photograph's is seen
        return (FOOD,) if len(runs) == last else Failure(code if len(runs) == 1 else "focal_unknown", "")

    failed = run_with_fallbacks(pair, options, Stages(), steps)
    assert runs == tried
    assert failed.failure.code == code  # that of the pair as it was sent
    runs.clear()
    run = run_with_fallbacks(pair, options, Stages(), lambda *inputs: steps(*inputs, last=len(tried)))
    assert runs == tried
    assert run.items == (FOOD,)
