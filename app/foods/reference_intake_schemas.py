"""Reference intakes over the wire. What a source does not set is null, never 0."""

from dataclasses import asdict
from typing import Literal

from pydantic import BaseModel, Field

from app.core.units import Unit
from app.http.field_descriptions import NUMBER
from app.nutrition.intakes.energy_requirement import Energy, LeftOut
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import Basis, FoodGroup, Per, UlScope


class ReferenceIntakeOut(BaseModel):
    """One nutrient: each kind of reference value in its own field, in `unit` a day, or a day and kilogram."""

    number: str = Field(
        description="The component to compare with, after what `compared_with` says."
    )
    tagname: str = Field(description="INFOODS tagname, such as VITC.")
    name: str = Field(description="The nutrient's name.")
    unit: Unit = Field(description="Unit of the figures.")
    per: Per = Field(
        description="Whether the figures are per day, or per day and kilogram of body weight."
    )
    ear: float | None = Field(
        description="Estimated Average Requirement: meets the need of half the group."
    )
    rda: float | None = Field(
        description="Recommended Dietary Allowance: meets the need of nearly all."
    )
    ai: float | None = Field(
        description="Adequate Intake, where no requirement is known; it is no RDA."
    )
    ul: float | None = Field(
        description="Tolerable Upper Intake Level, of the sources that `ul_scope` names."
    )
    ul_scope: UlScope | None = Field(
        description="Which sources the UL counts; null: there is no UL."
    )
    ul_number: str | None = Field(
        description="The component to compare the UL with; null: none measures its scope."
    )
    cdrr: float | None = Field(
        description="Chronic Disease Risk Reduction intake: above it less is better; no UL."
    )
    compared_with: str = Field(description="Which component is compared, and what to mind.")
    source: str = Field(description="The publication that the figures are from.")


class DistributionRangeOut(BaseModel):
    """Acceptable Macronutrient Distribution Range, percent of energy."""

    number: str = Field(description=NUMBER)
    name: str = Field(description="The nutrient's name.")
    low_percent: float = Field(description="Lower end, percent of energy.")
    high_percent: float = Field(description="Upper end, percent of energy.")
    source: str = Field(description="The publication that the range is from.")


class LeftOutOut(BaseModel):
    """Why there is no figure: inputs that are missing, or outside what the equation was made for."""

    reason: Literal["missing", "outside"] = Field(description="missing or outside")
    inputs: list[str] = Field(description="Names of the inputs.")
    message: str = Field(description="The same in a sentence.")


class EnergyOut(BaseModel):
    """An energy by equation; without a figure, `left_out` tells why. Nothing is ever assumed."""

    kcal_per_day: float | None = Field(description="Null: `left_out` says why.")
    sd_kcal: float | None = Field(
        description="Standard error of the equation, where its source tells it."
    )
    equation: str | None = Field(description="Name of the equation; null: there is no figure.")
    source: str | None = Field(
        description="The publication that the equation is from; null: there is no figure."
    )
    left_out: LeftOutOut | None = Field(description="Why there is no figure; null: there is one.")


class FoodGroupRecommendationOut(BaseModel):
    """Grams a day of one or several food groups together."""

    source: str = Field(description="Who recommends it.")
    name: str = Field(description="Name of the recommendation.")
    groups: list[FoodGroup] = Field(description="The food groups that it is for, counted together.")
    low_g: float | None = Field(description="At least so many grams a day; null: no lower end.")
    target_g: float | None = Field(description="The source's own target, grams a day; null: none.")
    high_g: float | None = Field(description="At most so many grams a day; null: no upper end.")
    basis: Basis = Field(description="Only grams as eaten compare with what is seen on a plate.")
    note: str = Field(description="What to mind when comparing.")


class ReferenceIntakesOut(BaseModel):
    """What is recommended to a person of this life stage."""

    life_stage: LifeStage = Field(
        description="The group by age, sex, pregnancy and lactation that the figures are for."
    )
    intakes: list[ReferenceIntakeOut] = Field(description="One entry per nutrient.")
    distribution_ranges: list[DistributionRangeOut] = Field(
        description="Shares of the energy; empty below one year of age."
    )
    energy: EnergyOut = Field(description="Estimated energy requirement.")
    basal_metabolic_rate: EnergyOut = Field(description="Energy at complete rest.")
    food_groups: list[FoodGroupRecommendationOut] = Field(
        description="Recommended grams of food groups."
    )


def energy_out(result: Energy | LeftOut) -> EnergyOut:
    """Return an energy, or the reason why there is none, as the API shows it."""
    if isinstance(result, LeftOut):
        absent = dict.fromkeys(("kcal_per_day", "sd_kcal", "equation", "source"))
        return EnergyOut.model_validate(absent | {"left_out": asdict(result)})
    return EnergyOut.model_validate(
        asdict(result) | {"kcal_per_day": round(result.kcal_per_day, 1), "left_out": None}
    )
