"""/v1/reference-intakes: what is recommended to a person, each figure with its source."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.core.errors import InvalidInputError
from app.foods.reference_intake_schemas import ReferenceIntakesOut, energy_out
from app.http.problems import problem_responses
from app.nutrition.intakes.energy_requirement import (
    HEIGHT_LIMITS_M,
    TRIMESTERS,
    WEIGHT_LIMITS_KG,
    Activity,
    Person,
    basal_metabolic_rate,
    estimated_energy_requirement,
)
from app.nutrition.intakes.life_stage import MAX_AGE_YEARS, Sex, life_stage
from app.nutrition.intakes.reference_intakes import (
    distribution_ranges,
    recommendations,
    reference_intakes,
)
from app.people.access.deps import CurrentCaller

router = APIRouter(prefix="/v1/reference-intakes", tags=["reference intakes"])


@router.get("", responses=problem_responses(401, 422))
def get_reference_intakes(
    _: CurrentCaller,
    age_years: Annotated[
        float | None, Query(ge=0, le=MAX_AGE_YEARS, description="Or age_months.")
    ] = None,
    age_months: Annotated[
        float | None, Query(ge=0, le=36, description="For infants, instead of age_years.")
    ] = None,
    sex: Annotated[
        Sex | None, Query(description="Needed from 9 years on; for energy from 3.")
    ] = None,
    pregnant: Annotated[bool, Query(description="14 to 50 years.")] = False,
    trimester: Annotated[
        int | None, Query(ge=1, le=3, description="Of the pregnancy, for its energy.")
    ] = None,
    lactating: Annotated[bool, Query(description="14 to 50 years.")] = False,
    lactation_months: Annotated[
        int | None, Query(ge=0, le=60, description="Since birth, for its energy.")
    ] = None,
    weight_kg: Annotated[
        float | None,
        Query(
            ge=WEIGHT_LIMITS_KG[0], le=WEIGHT_LIMITS_KG[1], description="In pregnancy, before it."
        ),
    ] = None,
    height_m: Annotated[
        float | None,
        Query(ge=HEIGHT_LIMITS_M[0], le=HEIGHT_LIMITS_M[1], description="Body height, for energy."),
    ] = None,
    activity: Annotated[
        Activity | None, Query(description="PAL from 1.0, 1.4, 1.6 and 1.9.")
    ] = None,
) -> ReferenceIntakesOut:
    """Dietary Reference Intakes of the life stage, energy by equation or why it is left out, food groups in grams."""
    age = _age_in_years(age_years, age_months)
    try:
        stage = life_stage(age, sex, is_pregnant=pregnant, is_lactating=lactating)
        person = Person(
            age_years=age,
            sex=sex,
            weight_kg=weight_kg,
            height_m=height_m,
            activity=activity,
            is_pregnant=pregnant,
            trimester=next((option for option in TRIMESTERS if option == trimester), None),
            is_lactating=lactating,
            lactation_months=lactation_months,
        )
    except ValueError as error:
        message = str(error)
        raise InvalidInputError(f"{message[:1].upper()}{message[1:]}.") from error
    return ReferenceIntakesOut.model_validate(
        {
            "life_stage": stage,
            "intakes": reference_intakes(stage),
            "distribution_ranges": distribution_ranges(age),
            "energy": energy_out(estimated_energy_requirement(person)),
            "basal_metabolic_rate": energy_out(basal_metabolic_rate(person)),
            "food_groups": recommendations(age),
        },
        from_attributes=True,
    )


def _age_in_years(age_years: float | None, age_months: float | None) -> float:
    """Return the age in years. Raises InvalidInputError unless exactly one of the two is given."""
    if age_years is not None and age_months is None:
        return age_years
    if age_months is not None and age_years is None:
        return age_months / 12.0
    raise InvalidInputError("Give the age once, as age_years or, for infants, as age_months.")
