"""Reference intakes over the wire. What a source does not set is null, never 0."""

from pydantic import BaseModel, ConfigDict, Field

from app.nutrition.energy_requirement import Energy, LeftOut
from app.nutrition.food_groups import Basis, FoodGroup
from app.nutrition.life_stage import LifeStage
from app.nutrition.reference_intakes import Per, UlScope
from app.units import Unit


class ReferenceIntakeOut(BaseModel):
    """One nutrient: each kind of reference value in its own field, in `unit` a day, or a day and kilogram."""

    model_config = ConfigDict(from_attributes=True)

    number: str = Field(description="The component to compare with, after what `compared_with` says.")
    tagname: str
    name: str
    unit: Unit
    per: Per
    ear: float | None = Field(description="Estimated Average Requirement: meets the need of half the group.")
    rda: float | None = Field(description="Recommended Dietary Allowance: meets the need of nearly all.")
    ai: float | None = Field(description="Adequate Intake, where no requirement is known; it is no RDA.")
    ul: float | None = Field(description="Tolerable Upper Intake Level, of the sources that `ul_scope` names.")
    ul_scope: UlScope | None
    ul_number: str | None = Field(description="The component to compare the UL with; null: none measures its scope.")
    cdrr: float | None = Field(description="Chronic Disease Risk Reduction intake: above it less is better; no UL.")
    compared_with: str
    source: str


class DistributionRangeOut(BaseModel):
    """Acceptable Macronutrient Distribution Range, percent of energy."""

    model_config = ConfigDict(from_attributes=True)

    number: str
    name: str
    low_percent: float
    high_percent: float
    source: str


class LeftOutOut(BaseModel):
    """Why there is no figure: inputs that are missing, or outside what the equation was made for."""

    reason: str = Field(description="missing or outside")
    inputs: list[str]
    message: str


class EnergyOut(BaseModel):
    """An energy by equation; without a figure, `left_out` tells why. Nothing is ever assumed."""

    kcal_per_day: float | None
    sd_kcal: float | None = Field(description="Standard error of the equation, where its source tells it.")
    equation: str | None
    source: str | None
    left_out: LeftOutOut | None


class FoodGroupRecommendationOut(BaseModel):
    """Grams a day of one or several food groups together."""

    model_config = ConfigDict(from_attributes=True)

    source: str
    name: str
    groups: list[FoodGroup]
    low_g: float | None
    target_g: float | None
    high_g: float | None
    basis: Basis = Field(description="Only grams as eaten compare with what is seen on a plate.")
    note: str


class ReferenceIntakesOut(BaseModel):
    """What is recommended to a person of this life stage."""

    life_stage: LifeStage
    intakes: list[ReferenceIntakeOut]
    distribution_ranges: list[DistributionRangeOut]
    energy: EnergyOut
    basal_metabolic_rate: EnergyOut
    food_groups: list[FoodGroupRecommendationOut]


def energy_out(found: Energy | LeftOut) -> EnergyOut:
    """A figure, or why there is none."""
    if isinstance(found, LeftOut):
        left_out = LeftOutOut(reason=found.reason, inputs=list(found.inputs), message=found.message)
        return EnergyOut(kcal_per_day=None, sd_kcal=None, equation=None, source=None, left_out=left_out)
    return EnergyOut(
        kcal_per_day=round(found.kcal_per_day, 1),
        sd_kcal=found.sd_kcal,
        equation=found.equation,
        source=found.source,
        left_out=None,
    )
