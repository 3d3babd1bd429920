"""Figures against the published tables (NASEM 2019, appendix J; IOM 2011), and what must hold of every line."""

import pytest

from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.intakes.life_stage import LifeStage, life_stage
from app.nutrition.intakes.reference_intakes import distribution_ranges, reference_intakes

EVERY_INTAKE = [(stage, intake) for stage in LifeStage for intake in reference_intakes(stage)]


def intake_of(stage, number, per="day"):
    return next(intake for intake in reference_intakes(stage) if (intake.number, intake.per) == (number, per))


@pytest.mark.parametrize(
    ("age_years", "sex", "stage"),
    [
        (0.0, None, "infant_0_6_months"),
        (5 / 12, None, "infant_0_6_months"),
        (6 / 12, "male", "infant_7_12_months"),
        (0.999, None, "infant_7_12_months"),
        (1.0, None, "child_1_3"),
        (3.99, "female", "child_1_3"),
        (4.0, None, "child_4_8"),
        (8.99, "female", "child_4_8"),
        (9.0, "female", "female_9_13"),
        (18.9, "male", "male_14_18"),
        (19.0, "male", "male_19_30"),
        (31.0, "female", "female_31_50"),
        (50.9, "male", "male_31_50"),
        (51.0, "female", "female_51_70"),
        (70.9, "female", "female_51_70"),
        (71.0, "male", "male_over_70"),
        (120.0, "female", "female_over_70"),
    ],
)
def test_age_and_sex_give_the_column(age_years, sex, stage):
    assert life_stage(age_years, sex) == stage


def test_pregnancy_and_lactation_have_their_own_columns_also_without_a_sex():
    assert life_stage(14, is_pregnant=True) == "pregnant_14_18"
    assert life_stage(30.9, "female", is_pregnant=True) == "pregnant_19_30"
    assert life_stage(50.9, "female", is_lactating=True) == "lactating_31_50"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"age_years": -0.1}, "between 0 and 120"),
        ({"age_years": 120.1}, "between 0 and 120"),
        ({"age_years": float("nan")}, "between 0 and 120"),
        ({"age_years": 25.0, "sex": "male", "is_lactating": True}, "for females"),
        ({"age_years": 9.0}, "differ by sex"),
        ({"age_years": 25.0, "sex": "male", "is_pregnant": True}, "for females"),
        ({"age_years": 13.9, "sex": "female", "is_pregnant": True}, "14 to 50"),
        ({"age_years": 51.0, "sex": "female", "is_lactating": True}, "14 to 50"),
        ({"age_years": 25.0, "sex": "female", "is_pregnant": True, "is_lactating": True}, "at once"),
    ],
)
def test_what_the_tables_have_no_column_for_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        life_stage(**arguments)


# stage, component: EAR, RDA, AI, UL as published, in the component's unit
PUBLISHED = {
    ("female_31_50", "303"): (8.1, 18, None, 45),
    ("pregnant_19_30", "303"): (22, 27, None, 45),
    ("infant_0_6_months", "303"): (None, None, 0.27, 40),
    ("female_19_30", "320"): (500, 700, None, 3000),
    ("pregnant_14_18", "435"): (520, 600, None, 800),
    ("child_4_8", "312"): (0.34, 0.44, None, 3),
    ("male_19_30", "315"): (None, None, 2.3, 11),
    ("infant_0_6_months", "204"): (None, None, 31, None),
    ("male_9_13", "313"): (None, None, 2000, 10000),
}


@pytest.mark.parametrize(("stage", "number"), list(PUBLISHED))
def test_figures_are_the_published_ones(stage, number):
    intake = intake_of(LifeStage(stage), number)
    assert (intake.ear, intake.rda, intake.ai, intake.ul) == PUBLISHED[stage, number]


def test_sodium_has_an_ai_and_a_cdrr_and_no_ul():
    figures = {
        stage: (intake_of(stage, "307").ai, intake_of(stage, "307").cdrr, intake_of(stage, "307").ul)
        for stage in (LifeStage.INFANT_0_6_MONTHS, LifeStage.CHILD_1_3, LifeStage.MALE_9_13, LifeStage.FEMALE_OVER_70)
    }
    assert list(figures.values()) == [(110, None, None), (800, 1200, None), (1200, 1800, None), (1500, 2300, None)]
    assert {intake.number for _, intake in EVERY_INTAKE if intake.cdrr is not None} == {"307"}


def test_a_ul_tells_what_it_counts_and_with_what_it_compares():
    scopes = {intake.number: (intake.ul_scope, intake.ul_number) for _, intake in EVERY_INTAKE if intake.ul is not None}
    assert scopes["304"] == ("supplements_only", None)
    assert scopes["406"] == ("synthetic_only", None)
    assert scopes["435"] == ("synthetic_only", "431")
    assert scopes["323"] == ("synthetic_only", "573")
    assert scopes["320"] == ("preformed_only", "319")
    rest = scopes.keys() - {"304", "406", "435", "323", "320"}
    assert all(scopes[number] == ("all_sources", number) for number in rest)


def test_figures_of_every_line_are_in_order_in_the_components_unit_and_only_where_the_source_sets_them():
    for stage, intake in EVERY_INTAKE:
        assert intake.rda is None or intake.ai is None, (stage, intake.number)
        assert intake.ear is None or intake.rda is not None, (stage, intake.number)
        assert (intake.ul_scope is None) == (intake.ul is None), (stage, intake.number)
        assert intake.ear is None or intake.ear < intake.rda, (stage, intake.number)
        if intake.ul_scope == "all_sources":
            assert (intake.rda or intake.ai) <= intake.ul, (stage, intake.number)
        component = COMPONENT_BY_NUMBER[intake.number]
        assert (intake.unit, intake.tagname) == (component.unit, component.tagname)
        assert intake.ul_number is None or COMPONENT_BY_NUMBER[intake.ul_number].unit == intake.unit


@pytest.mark.parametrize(
    ("age_years", "fat", "protein"), [(2, (30, 40), (5, 20)), (18.9, (25, 35), (10, 30)), (19, (20, 35), (10, 35))]
)
def test_distribution_ranges_follow_age(age_years, fat, protein):
    ranges = {found.number: (found.low_percent, found.high_percent) for found in distribution_ranges(age_years)}
    assert (ranges["204"], ranges["203"], ranges["205"]) == (fat, protein, (45, 65))
    assert (ranges["675"], ranges["851"]) == ((5, 10), (0.6, 1.2))
    assert distribution_ranges(0.99) == ()  # infants have none
