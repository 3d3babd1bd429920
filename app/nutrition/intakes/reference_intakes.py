"""Dietary Reference Intakes (US and Canada) by life stage, and recommendations by food group.

EAR, RDA, AI, UL and CDRR: docs/feedback.md explains each kind and its valid comparisons.
reference/dri.csv has one line per nutrient and stage; reference/dri_nutrients.csv has each
nutrient's source volume, the sources that its UL counts, and the component of the food table to
compare with. Keys are component numbers (components.py). The grams a day of food groups are those
of WHO and EAT-Lancet.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from app.core.units import Unit
from app.nutrition.components import packaged_rows
from app.nutrition.intakes.life_stage import LifeStage, check_age

Per = Literal["day", "kg_day"]
UlScope = Literal["all_sources", "synthetic_only", "supplements_only", "preformed_only"]

PERS: tuple[Per, ...] = get_args(Per)
UL_SCOPES: tuple[UlScope, ...] = get_args(UlScope)
FoodGroup = Literal[
    "fruit", "fruit_juice", "dried_fruit", "vegetables", "vegetable_juice", "starchy_tubers", "legumes", "soy", "nuts",
    "grains", "milk", "cheese", "eggs", "beef_lamb", "pork", "poultry", "fish", "processed_meat", "dairy_fat",
    "palm_oil", "unsaturated_oils", "lard_tallow", "sugars", "beverages",
]  # fmt: skip
Basis = Literal["as_eaten", "dry", "milk_equivalent"]

FOOD_GROUPS: tuple[FoodGroup, ...] = get_args(FoodGroup)
BASES: tuple[Basis, ...] = get_args(Basis)


@dataclass(frozen=True, slots=True)
class ReferenceIntake:
    """One nutrient's reference values for one stage, in `unit` per day, or per day and kilogram of body weight.

    number: the component to compare EAR, RDA, AI and CDRR with, subject to `compared_with`. A
    figure that the source does not set is None; a nutrient has an RDA or an AI, never both. ear:
    meets the requirement of half the group. rda: of nearly all. ai: assumed to be adequate, if no
    EAR is known. ul: highest intake without expected harm, of the sources in ul_scope, compared
    with component ul_number, which is None if no component of food tables measures it. cdrr: above
    it, eating less lowers chronic disease risk.
    """

    number: str
    tagname: str
    name: str
    unit: Unit
    per: Per
    ear: float | None
    rda: float | None
    ai: float | None
    ul: float | None
    ul_scope: UlScope | None
    ul_number: str | None
    cdrr: float | None
    compared_with: str
    source: str


@dataclass(frozen=True, slots=True)
class DistributionRange:
    """Acceptable Macronutrient Distribution Range: recommended share of the energy from a nutrient, percent."""

    number: str
    name: str
    low_percent: float
    high_percent: float
    source: str


AMDR_SOURCE = "IOM 2002/2005: Energy, Carbohydrate, Fiber, Fat, Fatty Acids, Cholesterol, Protein, and Amino Acids"


def reference_intakes(stage: LifeStage) -> tuple[ReferenceIntake, ...]:
    """Return all nutrients with a reference value at this stage, in the table's order; protein per day and kilogram."""
    return _by_stage()[stage]


def distribution_ranges(age_years: float) -> tuple[DistributionRange, ...]:
    """Return the AMDRs at this age; below one year the source sets none.

    Raises ValueError for an impossible age.
    """
    check_age(age_years)
    return tuple(
        DistributionRange(
            row["number"],
            row["name"],
            float(row["low_percent"]),
            float(row["high_percent"]),
            AMDR_SOURCE,
        )
        for row in packaged_rows("reference", "amdr.csv")
        if float(row["from_years"]) <= age_years < float(row["below_years"] or "inf")
    )


@cache
def _by_stage() -> dict[LifeStage, tuple[ReferenceIntake, ...]]:
    nutrients = {row["number"]: row for row in packaged_rows("reference", "dri_nutrients.csv")}
    by_stage: dict[LifeStage, list[ReferenceIntake]] = {stage: [] for stage in LifeStage}
    for row in packaged_rows("reference", "dri.csv"):
        intake = _intake(nutrients[row["number"]], row)
        if any(
            figure is not None
            for figure in (intake.ear, intake.rda, intake.ai, intake.ul, intake.cdrr)
        ):
            by_stage[LifeStage(row["stage"])].append(intake)
    return {stage: tuple(intakes) for stage, intakes in by_stage.items()}


def _intake(nutrient: Mapping[str, str], row: Mapping[str, str]) -> ReferenceIntake:
    ear, rda, ai, ul, cdrr = (
        float(row[kind]) if row[kind] else None for kind in ("ear", "rda", "ai", "ul", "cdrr")
    )
    return ReferenceIntake(
        number=nutrient["number"],
        tagname=nutrient["tagname"],
        name=nutrient["name"],
        unit=Unit(nutrient["unit"]),
        per=next(per for per in PERS if per == row["per"]),
        ear=ear,
        rda=rda,
        ai=ai,
        ul=ul,
        ul_scope=None
        if ul is None
        else next(scope for scope in UL_SCOPES if scope == nutrient["ul_scope"]),
        ul_number=None if ul is None else nutrient["ul_number"] or None,
        cdrr=cdrr,
        compared_with=nutrient["compared_with"],
        source=nutrient["source"],
    )


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Grams per day of one or several groups together: at least low_g, at most high_g, target_g in the source's diet.

    basis: what the grams refer to; only those of food as eaten compare with what a camera sees.
    note: caveats.
    """

    source: str
    name: str
    groups: tuple[FoodGroup, ...]
    low_g: float | None
    target_g: float | None
    high_g: float | None
    basis: Basis
    note: str


def recommendations(age_years: float) -> tuple[Recommendation, ...]:
    """Return the recommendations for this age: WHO from 2 years, EAT-Lancet for adults.

    Raises ValueError.
    """
    check_age(age_years)
    return tuple(
        recommendation
        for from_years, below_years, recommendation in _all()
        if from_years <= age_years < below_years
    )


@cache
def _all() -> tuple[tuple[float, float, Recommendation], ...]:
    return tuple(
        (float(row["from_years"]), float(row["below_years"] or "inf"), _recommendation(row))
        for row in packaged_rows("reference", "food_group_recommendations.csv")
    )


def _recommendation(row: Mapping[str, str]) -> Recommendation:
    return Recommendation(
        source=row["source"],
        name=row["name"],
        groups=tuple(group for group in FOOD_GROUPS if group in row["groups"].split()),
        low_g=float(row["low_g"]) if row["low_g"] else None,
        target_g=float(row["target_g"]) if row["target_g"] else None,
        high_g=float(row["high_g"]) if row["high_g"] else None,
        basis=next(basis for basis in BASES if basis == row["basis"]),
        note=row["note"],
    )
