"""What a person of this age, sex and state should eat: reference intakes, ranges, energy, food groups. No database."""

from dataclasses import dataclass

from app.core.errors import InvalidInputError
from app.nutrition.intakes.energy_requirement import (
    Activity,
    Energy,
    LeftOut,
    Person,
    Trimester,
    basal_metabolic_rate,
    estimated_energy_requirement,
)
from app.nutrition.intakes.food_groups import Recommendation, recommendations
from app.nutrition.intakes.life_stage import LifeStage, Sex, life_stage
from app.nutrition.intakes.reference_intakes import (
    DistributionRange,
    ReferenceIntake,
    distribution_ranges,
    reference_intakes,
)


@dataclass(frozen=True, slots=True)
class ReferenceView:
    """All that the sources recommend to one person."""

    stage: LifeStage
    intakes: tuple[ReferenceIntake, ...]
    ranges: tuple[DistributionRange, ...]
    energy: Energy | LeftOut
    basal_rate: Energy | LeftOut
    food_groups: tuple[Recommendation, ...]


def age_in_years(age_years: float | None, age_months: float | None) -> float:
    """The age from whichever is given. Raises InvalidInputError unless exactly one is."""
    if age_years is not None and age_months is None:
        return age_years
    if age_months is not None and age_years is None:
        return age_months / 12.0
    raise InvalidInputError("Give the age once, as age_years or, for infants, as age_months.")


def read_reference_intakes(
    age_years: float,
    *,
    sex: Sex | None,
    is_pregnant: bool,
    trimester: Trimester | None,
    is_lactating: bool,
    lactation_months: int | None,
    weight_kg: float | None,
    height_m: float | None,
    activity: Activity | None,
) -> ReferenceView:
    """The recommendations for a person; what is not known is None.

    Raises InvalidInputError where the values cannot be or the tables have no column for them.
    """
    try:
        stage = life_stage(age_years, sex, is_pregnant=is_pregnant, is_lactating=is_lactating)
        person = Person(
            age_years=age_years,
            sex=sex,
            weight_kg=weight_kg,
            height_m=height_m,
            activity=activity,
            is_pregnant=is_pregnant,
            trimester=trimester,
            is_lactating=is_lactating,
            lactation_months=lactation_months,
        )
    except ValueError as error:
        words = str(error)
        raise InvalidInputError(f"{words[:1].upper()}{words[1:]}.") from error
    return ReferenceView(
        stage=stage,
        intakes=reference_intakes(stage),
        ranges=distribution_ranges(age_years),
        energy=estimated_energy_requirement(person),
        basal_rate=basal_metabolic_rate(person),
        food_groups=recommendations(age_years),
    )
