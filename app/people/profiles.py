"""A participant's profile, as it is stored: what reference intakes and the plausibility of energies depend on."""

from typing import TypedDict

from app.nutrition.intakes.energy_requirement import Activity, Person, Trimester
from app.nutrition.intakes.life_stage import Sex


class Profile(TypedDict, total=False):
    """Only what is known; keys are absent otherwise."""

    sex: Sex
    birth_year: int
    height_cm: float
    weight_kg: float
    activity: Activity
    is_pregnant: bool
    trimester: Trimester
    is_lactating: bool
    lactation_months: int


PROFILE_KEYS = tuple(Profile.__annotations__)


def person_at_age(profile: Profile, age_years: float) -> Person:
    """Return the person of a profile.

    Raises ValueError if the profile contradicts itself at this age.
    """
    height_cm = profile.get("height_cm")
    return Person(
        age_years=age_years,
        sex=profile.get("sex"),
        weight_kg=profile.get("weight_kg"),
        height_m=height_cm / 100.0 if height_cm is not None else None,
        activity=profile.get("activity"),
        is_pregnant=profile.get("is_pregnant", False),
        trimester=profile.get("trimester"),
        is_lactating=profile.get("is_lactating", False),
        lactation_months=profile.get("lactation_months"),
    )
