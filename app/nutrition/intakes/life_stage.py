"""Life stages of the Dietary Reference Intakes: age, sex, pregnancy and lactation -> the column of the tables.

Ages are completed years ("14-18 years" ends on the 19th birthday) or, below one year, completed
months. The tables have one column for both sexes up to 8 years; from 9 years they differ, so a sex
is required: the columns are never averaged.
"""

import math
import re
from enum import StrEnum
from typing import Literal, get_args

Sex = Literal["female", "male"]

SEXES: tuple[Sex, ...] = get_args(Sex)

MAX_AGE_YEARS = 120.0  # a greater age is a typing error
PREGNANCY_YEARS = (14, 50)  # the columns of pregnancy and lactation, first and last completed year


class LifeStage(StrEnum):
    """A column of the tables, in their order."""

    INFANT_0_6_MONTHS = "infant_0_6_months"
    INFANT_7_12_MONTHS = "infant_7_12_months"
    CHILD_1_3 = "child_1_3"
    CHILD_4_8 = "child_4_8"
    MALE_9_13 = "male_9_13"
    MALE_14_18 = "male_14_18"
    MALE_19_30 = "male_19_30"
    MALE_31_50 = "male_31_50"
    MALE_51_70 = "male_51_70"
    MALE_OVER_70 = "male_over_70"
    FEMALE_9_13 = "female_9_13"
    FEMALE_14_18 = "female_14_18"
    FEMALE_19_30 = "female_19_30"
    FEMALE_31_50 = "female_31_50"
    FEMALE_51_70 = "female_51_70"
    FEMALE_OVER_70 = "female_over_70"
    PREGNANT_14_18 = "pregnant_14_18"
    PREGNANT_19_30 = "pregnant_19_30"
    PREGNANT_31_50 = "pregnant_31_50"
    LACTATING_14_18 = "lactating_14_18"
    LACTATING_19_30 = "lactating_19_30"
    LACTATING_31_50 = "lactating_31_50"

    @property
    def in_words(self) -> str:
        """Return it as text: "female, 19 to 30", "male, over 70", "infant, 7 to 12 months"."""
        population, ages = self.value.split("_", 1)
        spans = re.sub(r"([0-9]+)_([0-9]+)", r"\1 to \2", ages)
        return f"{population}, {spans.replace('_', ' ')}"


# First completed year of each age group from 9 years on.
_AGE_GROUPS = (
    (71, "over_70"),
    (51, "51_70"),
    (31, "31_50"),
    (19, "19_30"),
    (14, "14_18"),
    (9, "9_13"),
)


def life_stage(
    age_years: float,
    sex: Sex | None = None,
    *,
    is_pregnant: bool = False,
    is_lactating: bool = False,
) -> LifeStage:
    """Return the stage of a person of this age (years, with decimals for infants: 5 months are 5 / 12).

    The tables' "0-6 months" ends with the sixth completed month, "7-12 months" with the first
    birthday. Raises ValueError if the age is impossible, if the tables need a sex that is not
    given, for a pregnant or lactating male, for pregnancy and lactation together (the tables have
    no such column), or for either outside 14 to 50 years.
    """
    check_age(age_years)
    if is_pregnant or is_lactating:
        return _motherhood(age_years, sex, is_pregnant=is_pregnant, is_lactating=is_lactating)
    if age_years < 1.0:
        return (
            LifeStage.INFANT_0_6_MONTHS
            if completed_months(age_years) < 6
            else LifeStage.INFANT_7_12_MONTHS
        )
    if age_years < 9.0:
        return LifeStage.CHILD_1_3 if age_years < 4.0 else LifeStage.CHILD_4_8
    if sex not in SEXES:
        raise ValueError("from 9 years on the reference intakes differ by sex: give female or male")
    return LifeStage(f"{sex}_{_age_group(age_years)}")


def check_age(age_years: float) -> None:
    """Raise ValueError if the age is impossible."""
    if not 0.0 <= age_years <= MAX_AGE_YEARS:
        raise ValueError(f"an age lies between 0 and {MAX_AGE_YEARS:.0f} years, not at {age_years}")


def completed_months(age_years: float) -> int:
    """Return the completed months of age; the small term keeps 5 / 12 years at 5 months."""
    return math.floor(age_years * 12.0 + 1e-9)


def _motherhood(
    age_years: float, sex: Sex | None, *, is_pregnant: bool, is_lactating: bool
) -> LifeStage:
    if sex == "male":
        raise ValueError("the reference intakes of pregnancy and lactation are for females")
    if is_pregnant and is_lactating:
        raise ValueError(
            "the reference intakes have no column for pregnancy and lactation at once: give one of them"
        )
    first, last = PREGNANCY_YEARS
    if not first <= age_years < last + 1:
        raise ValueError(
            f"the reference intakes of pregnancy and lactation are for {first} to {last} years"
        )
    return LifeStage(f"{'pregnant' if is_pregnant else 'lactating'}_{_age_group(age_years)}")


def _age_group(age_years: float) -> str:
    return next(name for first_year, name in _AGE_GROUPS if age_years >= first_year)
