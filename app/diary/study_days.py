"""A participant on a day, by their profile: the person, the life stage, and whether an energy intake is plausible."""

from datetime import date
from functools import cache

from app.diary.day_definition import FULL
from app.diary.queries import DayRow
from app.nutrition.intakes.energy_requirement import Person, basal_metabolic_rate
from app.nutrition.intakes.life_stage import LifeStage, Sex, life_stage
from app.nutrition.plausible import Plausibility, judge_energy
from app.people.profiles import Profile, person_at_age


def person_on(profile: Profile | None, day: date) -> Person | None:
    """Return the person in the year of a day; None without a birth year or if the profile contradicts itself then.

    The age is the one reached in that year, so it is a year too high until the birthday.
    """
    birth_year = profile.get("birth_year") if profile is not None else None
    if profile is None or birth_year is None:
        return None
    try:
        return person_at_age(profile, float(day.year - birth_year))
    # a profile that was consistent when it was set need not be consistent on every day
    except ValueError:
        return None


def stage_of(person: Person) -> LifeStage | None:
    """Return a person's life stage; None if it depends on the sex and that is unknown."""
    return _life_stage(
        person.age_years, person.effective_sex, person.is_pregnant, person.is_lactating
    )


def judge_days(
    profile: Profile | None, day: date, energy_kcal: float | None, days: int
) -> Plausibility:
    """Judge whether the mean energy of so many whole days is plausible for the participant.

    day: one of them.
    """
    person = person_on(profile, day)
    if person is None:
        return Plausibility("unknown", days, reason="profile_unknown")
    return judge_energy(
        energy_kcal,
        days,
        basal_metabolic_rate(person),
        age_years=person.age_years,
        activity=person.activity,
    )


def judge_day(row: DayRow) -> Plausibility:
    """Judge whether a single day's energy is plausible; unknown unless the day is complete and its energy known."""
    energy = row.amount("energy_kcal")
    is_whole = row.is_complete and energy.coverage is not None and energy.coverage >= FULL
    return judge_days(
        row.profile, row.local_date, energy.value if is_whole else None, int(is_whole)
    )


@cache  # participants of a study have few different ages
def _life_stage(
    age_years: float, sex: Sex | None, is_pregnant: bool, is_lactating: bool
) -> LifeStage | None:
    try:
        return life_stage(age_years, sex, is_pregnant=is_pregnant, is_lactating=is_lactating)
    except ValueError:
        return None
