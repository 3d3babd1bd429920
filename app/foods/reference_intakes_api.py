"""/v1/reference-intakes: what is recommended to a person, each figure with its source."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.foods.reference_intake_schemas import (
    DistributionRangeOut,
    FoodGroupRecommendationOut,
    ReferenceIntakeOut,
    ReferenceIntakesOut,
    energy_out,
)
from app.foods.reference_intakes import age_in_years, read_reference_intakes
from app.http.problems import problem_responses
from app.nutrition.intakes.energy_requirement import HEIGHT_LIMITS_M, TRIMESTERS, WEIGHT_LIMITS_KG, Activity
from app.nutrition.intakes.life_stage import MAX_AGE_YEARS, Sex
from app.people.access.deps import CurrentCaller

router = APIRouter(prefix="/v1/reference-intakes", tags=["reference intakes"])


@router.get("", responses=problem_responses(401, 422))
def get_reference_intakes(
    _: CurrentCaller,
    age_years: Annotated[float | None, Query(ge=0, le=MAX_AGE_YEARS, description="Or age_months.")] = None,
    age_months: Annotated[float | None, Query(ge=0, le=36, description="For infants, instead of age_years.")] = None,
    sex: Annotated[Sex | None, Query(description="Needed from 9 years on; for energy from 3.")] = None,
    pregnant: Annotated[bool, Query(description="14 to 50 years.")] = False,
    trimester: Annotated[int | None, Query(ge=1, le=3, description="Of the pregnancy, for its energy.")] = None,
    lactating: Annotated[bool, Query(description="14 to 50 years.")] = False,
    lactation_months: Annotated[int | None, Query(ge=0, le=60, description="Since birth, for its energy.")] = None,
    weight_kg: Annotated[
        float | None,
        Query(ge=WEIGHT_LIMITS_KG[0], le=WEIGHT_LIMITS_KG[1], description="In pregnancy, before it."),
    ] = None,
    height_m: Annotated[
        float | None, Query(ge=HEIGHT_LIMITS_M[0], le=HEIGHT_LIMITS_M[1], description="Body height, for energy.")
    ] = None,
    activity: Annotated[Activity | None, Query(description="PAL from 1.0, 1.4, 1.6 and 1.9.")] = None,
) -> ReferenceIntakesOut:
    """Dietary Reference Intakes of the life stage, energy by equation or why it is left out, food groups in grams."""
    view = read_reference_intakes(
        age_in_years(age_years, age_months),
        sex=sex,
        is_pregnant=pregnant,
        trimester=next((known for known in TRIMESTERS if known == trimester), None),
        is_lactating=lactating,
        lactation_months=lactation_months,
        weight_kg=weight_kg,
        height_m=height_m,
        activity=activity,
    )
    return ReferenceIntakesOut(
        life_stage=view.stage,
        intakes=[ReferenceIntakeOut.model_validate(intake) for intake in view.intakes],
        distribution_ranges=[DistributionRangeOut.model_validate(found) for found in view.ranges],
        energy=energy_out(view.energy),
        basal_metabolic_rate=energy_out(view.basal_rate),
        food_groups=[FoodGroupRecommendationOut.model_validate(found) for found in view.food_groups],
    )
