"""A food in a bowl of which only the rim is seen, by the whole pipeline to JSON: there, and without a volume.

Segmentation is the real one but for the bowl, which it is told of: around the rendered ball, with no wall in view.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from app.cli.main import print_estimate
from app.foods.food_amounts import amounts_of
from app.meals.estimate.estimate_json import answer_of
from app.nutrition.foods import load_starter_table
from app.vision import pipeline
from app.vision.model import EstimateOptions, Hint, PhotoPair
from app.vision.scene import liquids
from app.vision.scene.segmentation import segment_foods
from app.vision.scene.support import Support
from app.vision.scene.vessel import Vessel
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, rendered_views

NO_WALL = Vessel(np.array(BALL.centre_mm), 50.0, 45.0, np.empty((0, 2)))
HIDDEN_FLOOR = Support(20.0, 15.0, "bowl")
OPTIONS = EstimateOptions(SPEC, CAMERA, hints=(Hint(point=(748.0, 362.0), food="apple"),))


@pytest.mark.slow
def test_opaque_bowl_has_its_outline_hint_and_flag_but_no_volume_amount_or_picture_of_one(capsys):
    def in_a_bowl(*arguments, **options):
        foods = segment_foods(*arguments, **options)
        regions = [replace(region, support=HIDDEN_FLOOR, vessel=NO_WALL) for region in foods.regions]
        return replace(foods, regions=regions)

    left, right = rendered_views(BALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(liquids, "segment_foods", in_a_bowl)
        estimate = pipeline.estimate_meal(PhotoPair(left.photo, right.photo), OPTIONS, want_artefacts=True)
    answer = json.loads(json.dumps(answer_of(estimate, OPTIONS).as_json()))
    assert answer["failure"] is None
    (item,) = answer["items"]
    assert len(item["polygon"]) > 10
    assert (item["hint"], item["flags"]) == (0, ["not_measurable"])
    assert (item["volume_ml"], item["volume_interval_ml"], item["relative_sd"]) == (None, None, {})
    names = {artefact.name for artefact in estimate.artefacts}
    assert {"overlay.jpg", "disparity.jpg", "points.ply"} <= names
    assert names.isdisjoint({"slices.jpg", "points.jpg"})
    amounts = amounts_of(item, load_starter_table().food("apple"))
    print_estimate(answer_of(estimate, OPTIONS).as_json() | {"items": [item | amounts]}, None)
    assert "item 1: not measured, Apple, raw, with skin  [not_measurable]" in capsys.readouterr().out


def test_amounts_of_an_unknown_volume_are_null_and_the_food_stays():
    apple = load_starter_table().food("apple")
    unknown = {"volume_ml": None, "volume_interval_ml": None, "relative_sd": {}}
    assert amounts_of(unknown, apple) == {
        "food": {"key": "apple", "name": apple.name},
        "mass_g": None,
        "mass_interval_g": None,
        "edible_g": None,
        "energy_kcal": None,
    }
