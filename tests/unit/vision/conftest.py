"""The rendered ball's photographs and estimates that several files assert on: made once per worker, and read-only."""

import json

import pytest

from app.vision.figures import draw_artefacts
from app.vision.model import EstimateOptions, PhotoPair
from app.vision.pipeline import estimate_meal
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, on_plain_table, rendered_views


@pytest.fixture(scope="session")
def views():
    return rendered_views(BALL)


@pytest.fixture(scope="session")
def pair(views):
    return PhotoPair(*(view.photo for view in views))


@pytest.fixture(scope="session")
def ball_run(pair):
    """The pair's estimate by the marker, and what its artefacts were drawn of: (trace, pair, items)."""
    drawn = []

    def draw_and_keep(*arguments):
        drawn.append(arguments)
        return draw_artefacts(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.vision.pipeline.draw_artefacts", draw_and_keep)
        estimate = estimate_meal(pair, EstimateOptions(SPEC, CAMERA), want_artefacts=True)
    return estimate, drawn[0]


@pytest.fixture(scope="session")
def estimate(ball_run):
    return ball_run[0]


@pytest.fixture(scope="session")
def single(pair):
    """The estimate of the left photograph alone, by the marker."""
    photo = PhotoPair(on_plain_table(pair.left))
    return estimate_meal(photo, EstimateOptions(SPEC, CAMERA), want_artefacts=True)


@pytest.fixture(scope="session")
def scene_of():
    """Returns the scene.json among an estimate's artefacts."""

    def scene(estimate):
        (content,) = [each.content for each in estimate.artefacts if each.name == "scene.json"]
        return json.loads(content)

    return scene
