"""Dietary Reference Intakes (US and Canada) by life stage: EAR, RDA, AI, UL and CDRR.

docs/feedback.md explains each kind and its valid comparisons. reference/dri.csv has one line per nutrient and stage;
reference/dri_nutrients.csv has each nutrient's source volume, the sources that its UL counts, and the component of the
food table to compare with. Keys are component numbers (components.py).
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from app.core.units import Unit
from app.nutrition.intakes.life_stage import LifeStage, check_age
from app.nutrition.packaged_rows import packaged_rows

Per = Literal["day", "kg_day"]
UlScope = Literal["all_sources", "synthetic_only", "supplements_only", "preformed_only"]

PERS: tuple[Per, ...] = get_args(Per)
UL_SCOPES: tuple[UlScope, ...] = get_args(UlScope)


@dataclass(frozen=True, slots=True)
class ReferenceIntake:
    """One nutrient's reference values for one stage, in `unit` per day, or per day and kilogram of body weight.

    number: the component to compare EAR, RDA, AI and CDRR with, subject to `compared_with`. A figure that the source
    does not set is None; a nutrient has an RDA or an AI, never both.
    ear: meets the requirement of half the group. rda: of nearly all. ai: assumed to be adequate, if no EAR is known.
    ul: highest intake without expected harm, of the sources in ul_scope, compared with component ul_number, which is
    None if no component of food tables measures it. cdrr: above it, eating less lowers chronic disease risk.
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
    """Return the AMDRs at this age; below one year the source sets none. Raises ValueError for an impossible age."""
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


def _intake(nutrient: dict[str, str], row: dict[str, str]) -> ReferenceIntake:
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
