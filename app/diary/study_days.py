"""Who a participant was on a day, by the profile: the person, the life stage, and whether an energy is plausible."""

from collections.abc import Mapping
from datetime import date
from functools import cache
from typing import Any

from app.diary.day_definition import FULL
from app.diary.queries import DayRow
from app.nutrition.intakes.energy_requirement import Person, basal_metabolic_rate
from app.nutrition.intakes.life_stage import LifeStage, Sex, life_stage
from app.nutrition.plausible_energy import Plausibility, judge_energy


def person_on(profile: Mapping[str, Any] | None, day: date) -> Person | None:
    """Who a participant was in the year of a day; None without a birth year or where the profile contradicts itself.

    The age is the one that is reached in that year: until the birthday it is a year too much.
    """
    if profile is None or profile.get("birth_year") is None:
        return None
    height_cm = profile.get("height_cm")
    try:
        return Person(
            age_years=float(day.year - profile["birth_year"]),
            sex=profile.get("sex"),
            weight_kg=profile.get("weight_kg"),
            height_m=height_cm / 100.0 if height_cm is not None else None,
            activity=profile.get("activity"),
            is_pregnant=profile.get("is_pregnant") or False,
            trimester=profile.get("trimester"),
            is_lactating=profile.get("is_lactating") or False,
            lactation_months=profile.get("lactation_months"),
        )
    except ValueError:  # a profile that was possible when it was told need not be on every day
        return None


@cache  # a study's participants are of few ages
def stage_of(age_years: float, sex: Sex | None, is_pregnant: bool, is_lactating: bool) -> LifeStage | None:
    """Return the life stage; None where it needs a sex that is not known."""
    try:
        return life_stage(age_years, sex, is_pregnant=is_pregnant, is_lactating=is_lactating)
    except ValueError:
        return None


def stage_on(profile: Mapping[str, Any] | None, day: date) -> LifeStage | None:
    """Return the life stage of a participant on a day; None where the profile does not tell it."""
    person = person_on(profile, day)
    if person is None:
        return None
    return stage_of(person.age_years, person.known_sex, person.is_pregnant, person.is_lactating)


def judge_days(profile: Mapping[str, Any] | None, day: date, energy_kcal: float | None, days: int) -> Plausibility:
    """Whether a mean energy of so many whole days is plausible for the participant; day: one of them."""
    person = person_on(profile, day)
    if person is None:
        return Plausibility("unknown", days, reason="profile_unknown")
    return judge_energy(
        energy_kcal, days, basal_metabolic_rate(person), age_years=person.age_years, activity=person.activity
    )


def judge_day(row: DayRow) -> Plausibility:
    """Whether a single day's energy is plausible; unknown unless all that was eaten is told, measured and final."""
    energy = row.amount("energy_kcal")
    is_whole = row.is_complete and energy.coverage is not None and energy.coverage >= FULL
    return judge_days(row.profile, row.local_date, energy.value if is_whole else None, int(is_whole))
