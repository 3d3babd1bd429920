"""Equations against the energies that their sources print."""

from dataclasses import replace

import pytest

from app.nutrition.intakes.energy_requirement import (
    ACTIVITIES,
    Person,
    basal_metabolic_rate,
    estimated_energy_requirement,
)


def adult(**changes):
    known = {"age_years": 30, "sex": "male", "weight_kg": 68.0, "height_m": 1.65, "activity": "sedentary"}
    return Person(**(known | changes))


# IOM 2002/2005, EER at 30 years by height, for body mass indices of 18.5 (a hair more, so that rounding does not fall
# below) and 24.99. The printed figures are whole, some rounded down, hence 1 kcal.
@pytest.mark.parametrize(
    ("sex", "height_m", "bmi", "printed"),
    [
        ("male", 1.50, 24.99, (2080, 2267, 2506, 2898)),
        ("male", 1.65, 18.5001, (2068, 2254, 2490, 2880)),
        ("male", 1.80, 24.99, (2635, 2884, 3200, 3720)),
        ("female", 1.50, 18.5001, (1625, 1803, 2025, 2291)),
        ("female", 1.65, 24.99, (1982, 2202, 2477, 2807)),
        ("female", 1.80, 18.5001, (2015, 2239, 2519, 2855)),
    ],
)
def test_adults_energy_is_the_printed_one(sex, height_m, bmi, printed):
    for activity, kcal in zip(ACTIVITIES, printed, strict=True):
        person = adult(sex=sex, height_m=height_m, weight_kg=bmi * height_m**2, activity=activity)
        found = estimated_energy_requirement(person)
        assert (found.equation, found.kcal_per_day) == ("eer_adult", pytest.approx(kcal, abs=1.0))


# IOM 2007, Nutrition Standards for Foods in Schools, table B-1: expenditure of boys, to which growth is added (20 kcal
# from 3, 25 kcal from 9 years); its weights and heights are those of the growth charts.
@pytest.mark.parametrize(
    ("age_years", "weight_kg", "height_m", "printed", "growth_kcal"),
    [
        (3, 14.3, 0.95, (1142, 1304, 1465, 1663), 20),
        (8, 25.6, 1.28, (1433, 1672, 1911, 2205), 20),
        (9, 28.6, 1.34, (1505, 1762, 2018, 2334), 25),
        (15, 56.3, 1.70, (2198, 2593, 2988, 3474), 25),
    ],
)
def test_boys_energy_is_the_printed_expenditure_and_growth(age_years, weight_kg, height_m, printed, growth_kcal):
    for activity, kcal in zip(ACTIVITIES, printed, strict=True):
        boy = Person(age_years, "male", weight_kg, height_m, activity)
        assert estimated_energy_requirement(boy).kcal_per_day == pytest.approx(kcal + growth_kcal, abs=1.0)


def girl(**changes):
    return Person(
        **({"age_years": 16, "sex": "female", "weight_kg": 54.0, "height_m": 1.63, "activity": "active"} | changes)
    )


def test_girls_and_overweight_adults_energy_is_the_equation_by_hand():
    assert estimated_energy_requirement(girl()).kcal_per_day == pytest.approx(2369.27, abs=0.01)
    man = adult(age_years=45, weight_kg=110.0, height_m=1.75, activity="low_active")
    woman = adult(sex="female", age_years=45, weight_kg=90.0, height_m=1.65, activity="active")
    assert estimated_energy_requirement(man).kcal_per_day == pytest.approx(3134.70, abs=0.01)
    assert estimated_energy_requirement(woman).kcal_per_day == pytest.approx(2690.38, abs=0.01)
    assert estimated_energy_requirement(woman).equation == "tee_overweight_adult"


@pytest.mark.parametrize(
    ("months", "growth_kcal"), [(0, 175), (3, 175), (4, 56), (6, 56), (7, 22), (12, 22), (13, 20), (35, 20)]
)
def test_infants_energy_needs_weight_alone(months, growth_kcal):
    assert estimated_energy_requirement(Person(months / 12, weight_kg=8.0)).kcal_per_day == 89 * 8 - 100 + growth_kcal


@pytest.mark.parametrize("woman", [adult(sex="female", weight_kg=60.0), girl()])
def test_pregnancy_adds_by_trimester_and_lactation_by_half_year(woman):
    plain_kcal = estimated_energy_requirement(woman).kcal_per_day
    for trimester, added_kcal in ((1, 0), (2, 340), (3, 452)):
        pregnant = replace(woman, is_pregnant=True, trimester=trimester)
        assert estimated_energy_requirement(pregnant).kcal_per_day == pytest.approx(plain_kcal + added_kcal)
    for months, added_kcal in ((0, 330), (5, 330), (6, 400), (11, 400)):
        nursing = replace(woman, is_lactating=True, lactation_months=months)
        assert estimated_energy_requirement(nursing).kcal_per_day == pytest.approx(plain_kcal + added_kcal)


def test_all_missing_inputs_are_named_at_once_and_nothing_is_assumed():
    for name in ("sex", "weight_kg", "height_m", "activity"):
        found = estimated_energy_requirement(adult(**{name: None}))
        assert not found
        assert (found.reason, found.inputs) == ("missing", (name,))
    assert estimated_energy_requirement(Person(30)).inputs == ("sex", "weight_kg", "height_m", "activity")
    assert estimated_energy_requirement(Person(0.5)).inputs == ("weight_kg",)
    assert estimated_energy_requirement(adult(sex=None, is_pregnant=True)).inputs == ("trimester",)
    assert estimated_energy_requirement(adult(sex="female", is_lactating=True)).inputs == ("lactation_months",)


def test_what_an_equation_was_not_made_for_is_left_out():
    thin = adult(weight_kg=45.0, height_m=1.75)
    heavy_mother = adult(sex="female", weight_kg=90.0, is_pregnant=True, trimester=2)
    late = adult(sex="female", weight_kg=60.0, is_lactating=True, lactation_months=12)
    for person, inputs in (
        (thin, ("weight_kg", "height_m")),
        (heavy_mother, ("weight_kg", "height_m")),
        (late, ("lactation_months",)),
    ):
        found = estimated_energy_requirement(person)
        assert (found.reason, found.inputs) == ("outside", inputs)


@pytest.mark.parametrize(
    "changes",
    [
        {"age_years": -1},
        {"weight_kg": float("nan")},
        {"height_m": 165.0},
        {"trimester": 2},
        {"lactation_months": 2},
        {"is_pregnant": True},
        {"sex": "female", "age_years": 60, "is_pregnant": True},
        {"sex": "female", "is_lactating": True, "lactation_months": -1},
        {"sex": "unknown"},
        {"sex": "female", "is_pregnant": True, "trimester": 4},
    ],
)
def test_values_that_cannot_be_are_refused(changes):
    with pytest.raises(ValueError, match=r"\w"):
        adult(**changes)


# FAO/WHO/UNU 2004, section 5.4: women of 20 to 30 years, 55 kg: 1302 kcal. The rest by hand from its table 5.2.
@pytest.mark.parametrize(
    ("age_years", "sex", "weight_kg", "kcal", "sd_kcal"),
    [
        (25, "female", 55.0, 1301.6, 119),
        (18, "male", 70.0, 1746.2, 153),
        (30, "male", 70.0, 1676.1, 167),
        (60, "male", 70.0, 1407.5, 164),
        (59.9, "female", 60.0, 1333.2, 111),
        (60, "female", 60.0, 1203.4, 108),
        (10, "male", 35.0, 1277.2, 105),
        (17.9, "female", 50.0, 1361.8, 111),
        (3, "male", 15.0, 844.9, 67),
        (9.9, "female", 30.0, 1095.4, 70),
        (1, "male", 10.0, 564.7, 70),
        (2.9, "female", 12.0, 668.7, 59),
    ],
)
def test_basal_rate_is_the_printed_one(age_years, sex, weight_kg, kcal, sd_kcal):
    found = basal_metabolic_rate(Person(age_years, sex, weight_kg))
    assert (found.kcal_per_day, found.sd_kcal) == (pytest.approx(kcal, abs=0.06), sd_kcal)


def test_basal_rate_names_what_is_missing_and_leaves_out_pregnancy():
    assert basal_metabolic_rate(Person(30)).inputs == ("sex", "weight_kg")
    assert basal_metabolic_rate(Person(30, "female", 60.0, is_pregnant=True)).reason == "outside"
