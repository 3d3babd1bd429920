import pytest

PATH = "/v1/reference-intakes"


def intake_of(body, number, per="day"):
    return next(found for found in body["intakes"] if (found["number"], found["per"]) == (number, per))


def test_a_woman_gets_the_figures_of_her_column_with_their_sources(phone):
    answer = phone.get(PATH, age_years=35, sex="female")
    assert answer.status_code == 200
    body = answer.json()
    assert body["life_stage"] == "female_31_50"
    iron = intake_of(body, "303")
    assert (iron["ear"], iron["rda"], iron["ai"], iron["ul"], iron["unit"]) == (8.1, 18, None, 45, "mg")
    assert iron["source"].startswith("IOM 2001")
    sodium = intake_of(body, "307")
    assert (sodium["ai"], sodium["ul"], sodium["cdrr"]) == (1500, None, 2300)
    assert intake_of(body, "304")["ul_scope"] == "supplements_only"
    assert intake_of(body, "203", "kg_day")["rda"] == 0.8
    assert {found["name"] for found in body["food_groups"]} >= {"Vegetables and fruits", "Whole grains"}


def test_energy_needs_all_inputs_and_names_the_missing_ones(phone):
    known = {"age_years": 30, "sex": "male", "weight_kg": 68.0, "height_m": 1.65}
    left_out = phone.get(PATH, **known).json()["energy"]
    assert (left_out["kcal_per_day"], left_out["left_out"]["inputs"]) == (None, ["activity"])
    energy = phone.get(PATH, **known, activity="sedentary").json()["energy"]
    assert energy["kcal_per_day"] == pytest.approx(2348.4, abs=0.1)
    assert energy["left_out"] is None


def test_infants_are_asked_for_in_months(phone):
    assert phone.get(PATH, age_months=5).json()["life_stage"] == "infant_0_6_months"
    body = phone.get(PATH, age_months=6, weight_kg=7.5).json()
    assert body["life_stage"] == "infant_7_12_months"
    assert body["energy"]["kcal_per_day"] == 89 * 7.5 - 100 + 56


def test_what_cannot_be_is_a_problem_document(phone):
    woman = {"age_years": 30, "sex": "female"}
    for params in (
        {},
        {"age_years": 1, "age_months": 12},
        {"age_years": 30},
        {"age_years": -1},
        {"age_years": 121, "sex": "male"},
        {"age_years": "nan", "sex": "male"},
        {"age_years": 30, "sex": "male", "pregnant": True},
        {"age_years": 12, "sex": "female", "pregnant": True},
        woman | {"pregnant": True, "lactating": True},
        woman | {"trimester": 2},
        woman | {"pregnant": True, "trimester": 4},
        woman | {"weight_kg": 0},
        woman | {"height_m": 165},
    ):
        answer = phone.get(PATH, **params)
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), params
        assert answer.headers["content-type"].startswith("application/problem+json")
        assert answer.json()["detail"]
