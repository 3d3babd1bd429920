"""The record names the index of foods where its candidates told a form, and only there."""

import cv2
import pytest

from app.identification.food_index import shipped_index
from app.meals.estimate.run_estimate import run_estimate
from app.vision.model import EstimateOptions, Hint
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, on_plain_table, rendered_views

ON_BALL = (720.0, 400.0)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    path = tmp_path_factory.mktemp("one") / "left.png"
    cv2.imwrite(str(path), on_plain_table(rendered_views(BALL)[0].photo).pixels_bgr)
    return {"left": path}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hints", "is_recorded"),
    [
        ((), True),
        ((Hint(point=ON_BALL, food="orange"),), True),
        ((Hint(point=ON_BALL, food="orange", usual_form="whole"),), False),
    ],
)
def test_index_is_recorded_where_it_told_the_form_of_a_food(photographs, hints, is_recorded):
    options = EstimateOptions(SPEC, CAMERA, hints=hints)
    answer, _ = run_estimate(photographs, options, max_pixels=10**7, on_stage=lambda _: None, want_artefacts=False)
    assert [item.hint for item in answer.items] == ([0] if hints else [None])
    recorded = answer.parameters.get("form_index")
    assert recorded == (shipped_index().version if is_recorded else None)
