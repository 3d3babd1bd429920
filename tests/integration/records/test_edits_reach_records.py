"""Corrections and measured densities reach the records when these are computed anew, in the study that they are for."""

import pytest

from app.core.units import Unit
from app.foods.component_names import Figure
from app.foods.edits import edit_food
from app.foods.edits.edit_food import Editor, FoodEdit
from app.foods.study_densities import Measurement, add_study_density, withdraw_study_density
from app.nutrition.foods import Density
from app.records.recompute_records import recompute_nutrients
from tests.support import estimates
from tests.integration.conftest import meal_metadata
from tests.support.estimates import found_item
from tests.support.photographs import pair

EDITOR = Editor("a test", "to see")


def eat_an_apple(phone, state):
    body = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
    assert phone.post(pair(), body).status_code == 202
    estimates.save(state, body["id"], found_item(hint=0))


def record_of(phone):
    (record,) = phone.get("/v1/records").json()["items"]
    return record


def recompute(state):
    recompute_nutrients(state.database, write=True, author="me", reason="a test", tell=lambda _: None)


def test_a_correction_reaches_records_and_its_undoing_too(phone, state):
    eat_an_apple(phone, state)
    before = record_of(phone)
    energy = FoodEdit(nutrients={"ENERC_KCAL": Figure(104.0, Unit.KCAL)})
    edit_food.edit_food(state.database, "apple", energy, EDITOR)
    assert record_of(phone) == before
    recompute(state)
    assert record_of(phone)["energy_kcal"] == pytest.approx(2 * before["energy_kcal"])
    edit_food.restore_food(state.database, "apple", 1, EDITOR)
    recompute(state)
    assert record_of(phone)["energy_kcal"] == pytest.approx(before["energy_kcal"])


def test_a_study_s_density_reaches_its_own_records_only(enrol, state):
    ours, theirs = enrol("P001", "pilot"), enrol("P002", "second")
    for phone in (ours, theirs):
        eat_an_apple(phone, state)
    before, others = record_of(ours), record_of(theirs)
    half = before["mass_g"] / before["volume_ml"] / 2
    measured = Measurement("apple", Density(half, 0.01, "raw", "solid", "study", "scale"))
    row = add_study_density(state.database, "pilot", measured, EDITOR)
    recompute(state)
    assert record_of(ours)["mass_g"] == pytest.approx(before["mass_g"] / 2)
    assert record_of(theirs) == others
    withdraw_study_density(state.database, "pilot", row.id, EDITOR)
    recompute(state)
    assert record_of(ours)["mass_g"] == pytest.approx(before["mass_g"])
