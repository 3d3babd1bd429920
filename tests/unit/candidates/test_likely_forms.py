import numpy as np
import pytest

from app.candidates.identify_photo import form_index_version, likely_foods
from app.identification.food_index import shipped_index
from app.nutrition.usual_form import FOOD_HEIGHTS
from app.vision.looks.vcm import LENGTH
from tests.support.looks import vectors_of


@pytest.mark.parametrize(("food", "form"), [("orange", "whole"), ("banana", "whole"), ("bread-white", "slab")])
def test_known_food_most_likely_has_its_kinds_usual_form(food, form):
    foods = likely_foods(vectors_of(shipped_index(), food)[0], None)
    assert sum(each.probability for each in foods if each.form == form) > 0.8
    assert sum(each.probability for each in foods) <= 1.0 + 1e-9
    known = sum(each.probability for each in foods if each.height == FOOD_HEIGHTS.get(food))
    assert known > 0.8


def test_food_like_none_of_the_index_says_little_of_its_form_and_an_unreadable_index_nothing(tmp_path):
    index = shipped_index()
    strange = index.metric.centre + 6.0 * index.metric.sd * np.where(np.arange(LENGTH) % 2, 1, -1)
    assert sum(each.probability for each in likely_foods(strange, None)) < 0.5
    damaged = tmp_path / "index.npz"
    damaged.write_bytes(b"no archive")
    assert form_index_version(damaged) is None
    assert likely_foods(strange, damaged) == []
