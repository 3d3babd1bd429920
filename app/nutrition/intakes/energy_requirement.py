"""Energy by equation, kcal per day: estimated requirement (IOM 2002/2005) and basal metabolic rate (Schofield 1985).

An energy is computed only if all inputs of its equation are known and within its range; otherwise
the result is a `LeftOut` that names the inputs missing or outside. No weight, height or activity is
ever assumed. An equation describes the mean of similar people, not an individual.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from app.nutrition.components import packaged_rows
from app.nutrition.intakes.life_stage import SEXES, Sex, check_age, completed_months, life_stage

Activity = Literal["sedentary", "low_active", "active", "very_active"]
Trimester = Literal[1, 2, 3]

TRIMESTERS: tuple[Trimester, ...] = get_args(Trimester)
ACTIVITIES: tuple[Activity, ...] = get_args(Activity)  # PAL 1.0-1.39, 1.4-1.59, 1.6-1.89, 1.9-2.5

EER_SOURCE = "IOM 2002/2005: Dietary Reference Intakes for Energy (EER)"
OVERWEIGHT_SOURCE = (
    "IOM 2002/2005: Dietary Reference Intakes for Energy (TEE of overweight and obese adults)"
)
BMR_SOURCE = "Schofield 1985, as in FAO/WHO/UNU 2004: Human Energy Requirements"

# kg/m2; the adults' EER was fitted within this range, the overweight adults' equation above it
NORMAL_BMI = (18.5, 25.0)
WEIGHT_LIMITS_KG = (1.0, 400.0)  # values outside are typing errors or wrong units (pounds, grams)
HEIGHT_LIMITS_M = (0.3, 2.6)  # likewise (centimetres, feet)


@dataclass(frozen=True, slots=True)
class Person:
    """Properties of a person that energy equations use; None if not known.

    weight_kg: in pregnancy, the weight before it. trimester: of the pregnancy. lactation_months:
    completed months since birth, while the child is breastfed. Raises ValueError if values are
    impossible or contradict each other.
    """

    age_years: float
    sex: Sex | None = None
    weight_kg: float | None = None
    height_m: float | None = None
    activity: Activity | None = None
    is_pregnant: bool = False
    trimester: Trimester | None = None
    is_lactating: bool = False
    lactation_months: int | None = None

    def __post_init__(self) -> None:
        check_age(self.age_years)
        _check_limits("weight", self.weight_kg, WEIGHT_LIMITS_KG, "kg")
        _check_limits("height", self.height_m, HEIGHT_LIMITS_M, "m")
        _check_choice("sex", self.sex, SEXES)
        _check_choice("activity", self.activity, ACTIVITIES)
        _check_choice("trimester", self.trimester, TRIMESTERS)
        if self.lactation_months is not None and self.lactation_months < 0:
            raise ValueError(f"months of lactation cannot be {self.lactation_months}")
        if self.trimester is not None and not self.is_pregnant:
            raise ValueError("a trimester is given, but no pregnancy")
        if self.lactation_months is not None and not self.is_lactating:
            raise ValueError("months of lactation are given, but no lactation")
        if self.is_pregnant or self.is_lactating:
            life_stage(
                self.age_years,
                self.sex,
                is_pregnant=self.is_pregnant,
                is_lactating=self.is_lactating,
            )

    @property
    def effective_sex(self) -> Sex | None:
        """Return the sex; female in pregnancy and lactation, even if it is not given."""
        return "female" if self.is_pregnant or self.is_lactating else self.sex


@dataclass(frozen=True, slots=True)
class Energy:
    """An energy by equation.

    sd_kcal: standard error of the equation's prediction, if its source gives it.
    """

    kcal_per_day: float
    equation: str
    source: str
    sd_kcal: float | None = None


@dataclass(frozen=True, slots=True)
class LeftOut:
    """The reason why there is no energy: inputs that are missing, or outside the range of the equation."""

    reason: Literal["missing", "outside"]
    inputs: tuple[str, ...]
    message: str

    def __bool__(self) -> bool:
        """Return False, so that `if energy` is true only for an energy."""
        return False


@dataclass(frozen=True, slots=True)
class _Equation:
    """kcal = constant - per_year * age + PA(activity) * (per_kg * weight + per_m * height)."""

    constant: float
    per_year: float
    per_kg: float
    per_m: float
    activity_factors: Mapping[str, float]

    def kcal(
        self, age_years: float, weight_kg: float, height_m: float, activity: Activity
    ) -> float:
        factor = self.activity_factors[activity]
        return (
            self.constant
            - self.per_year * age_years
            + factor * (self.per_kg * weight_kg + self.per_m * height_m)
        )


# from this age in years, energy deposited per day (IOM 2002/2005)
_GROWTH_KCAL = ((9.0, 25.0), (3.0, 20.0))
# likewise, from this completed month
_INFANT_GROWTH_KCAL = ((13, 20.0), (7, 22.0), (4, 56.0), (0, 175.0))
# 8 per week of pregnancy, and 180 deposited
_TRIMESTER_KCAL: Mapping[Trimester, float] = {1: 0.0, 2: 340.0, 3: 452.0}
# milk, minus energy from the mother's weight loss
_LACTATION_KCAL = ((6, 400.0), (0, 500.0 - 170.0))
_LAST_LACTATION_MONTH = 12  # the equations end there


def estimated_energy_requirement(person: Person) -> Energy | LeftOut:
    """Return the energy that balances a healthy person of this age, sex, weight, height and activity, with growth.

    Below 3 years from age and weight alone. 3 to 18 years: for children of normal weight, which is
    not checked, since that needs growth charts. Adults: EER for a body mass index from 18.5 to
    below 25 kg/m2; above, the equation for overweight and obese adults, which maintains the weight;
    below, left out. Pregnancy and lactation are added to the EER; with a body mass index above
    normal they are left out, since their source does not cover it.
    """
    if person.age_years < 3.0:
        return _infant_requirement(person)
    missing = _missing(person, "sex", "weight_kg", "height_m", "activity")
    missing += ("trimester",) if person.is_pregnant and person.trimester is None else ()
    missing += (
        ("lactation_months",) if person.is_lactating and person.lactation_months is None else ()
    )
    sex, weight_kg, height_m, activity = (
        person.effective_sex,
        person.weight_kg,
        person.height_m,
        person.activity,
    )
    if missing or sex is None or weight_kg is None or height_m is None or activity is None:
        return _left_out_missing(missing)
    if person.lactation_months is not None and person.lactation_months >= _LAST_LACTATION_MONTH:
        return LeftOut(
            "outside",
            ("lactation_months",),
            "The addition for lactation is known for its first year only.",
        )
    if person.age_years < 19.0:
        growth_kcal = next(
            kcal for first_year, kcal in _GROWTH_KCAL if person.age_years >= first_year
        )
        kcal = (
            _equations()["child", sex].kcal(person.age_years, weight_kg, height_m, activity)
            + growth_kcal
        )
        return _with_motherhood(person, kcal, "eer_child")
    bmi = weight_kg / height_m**2
    if bmi < NORMAL_BMI[0]:
        return LeftOut(
            "outside",
            ("weight_kg", "height_m"),
            f"No equation for a body mass index of {bmi:.1f} kg/m2.",
        )
    if bmi < NORMAL_BMI[1]:
        kcal = _equations()["adult", sex].kcal(person.age_years, weight_kg, height_m, activity)
        return _with_motherhood(person, kcal, "eer_adult")
    if person.is_pregnant or person.is_lactating:
        message = f"Pregnancy and lactation are not covered from a body mass index of {NORMAL_BMI[1]:.0f} kg/m2."
        return LeftOut("outside", ("weight_kg", "height_m"), message)
    kcal = _equations()["overweight_adult", sex].kcal(
        person.age_years, weight_kg, height_m, activity
    )
    return Energy(kcal, "tee_overweight_adult", OVERWEIGHT_SOURCE)


def basal_metabolic_rate(person: Person) -> Energy | LeftOut:
    """Return the energy spent at rest, by age, sex and weight; left out in pregnancy and lactation, which raise it."""
    if person.is_pregnant or person.is_lactating:
        state = "is_pregnant" if person.is_pregnant else "is_lactating"
        return LeftOut("outside", (state,), "The equations are not for pregnancy and lactation.")
    if person.sex is None or person.weight_kg is None:
        return _left_out_missing(_missing(person, "sex", "weight_kg"))
    rows = packaged_rows("reference", "basal_metabolic_rate.csv")  # the oldest first
    of_age = next(
        row
        for row in rows
        if row["sex"] == person.sex and person.age_years >= float(row["from_years"])
    )
    per_kg, constant, sd_kcal = (float(of_age[name]) for name in ("per_kg", "constant", "sd_kcal"))
    return Energy(per_kg * person.weight_kg + constant, "schofield_weight", BMR_SOURCE, sd_kcal)


@cache
def _equations() -> Mapping[tuple[str, str], _Equation]:
    """Return (population, sex) -> equation: IOM 2002/2005, chapter 5.

    child (3 to 18 years) and adult: of normal weight; overweight_adult: obese too.
    """
    return {
        (row["population"], row["sex"]): _Equation(
            constant=float(row["constant"]),
            per_year=float(row["per_year"]),
            per_kg=float(row["per_kg"]),
            per_m=float(row["per_m"]),
            activity_factors={activity: float(row[activity]) for activity in ACTIVITIES},
        )
        for row in packaged_rows("reference", "energy_equations.csv")
    }


def _infant_requirement(person: Person) -> Energy | LeftOut:
    if person.weight_kg is None:
        return _left_out_missing(("weight_kg",))
    months = completed_months(person.age_years)
    growth_kcal = next(kcal for first_month, kcal in _INFANT_GROWTH_KCAL if months >= first_month)
    return Energy(89.0 * person.weight_kg - 100.0 + growth_kcal, "eer_infant", EER_SOURCE)


def _with_motherhood(person: Person, kcal: float, equation: str) -> Energy:
    if person.trimester is not None:
        return Energy(kcal + _TRIMESTER_KCAL[person.trimester], f"{equation}_pregnant", EER_SOURCE)
    if person.lactation_months is not None:
        added = next(
            added
            for first_month, added in _LACTATION_KCAL
            if (person.lactation_months or 0) >= first_month
        )
        return Energy(kcal + added, f"{equation}_lactating", EER_SOURCE)
    return Energy(kcal, equation, EER_SOURCE)


def _missing(person: Person, *names: str) -> tuple[str, ...]:
    values = {name: getattr(person, "effective_sex" if name == "sex" else name) for name in names}
    return tuple(name for name, value in values.items() if value is None)


def _left_out_missing(inputs: tuple[str, ...]) -> LeftOut:
    return LeftOut("missing", inputs, f"Not known: {', '.join(inputs)}.")


def _check_choice(name: str, value: object, choices: tuple[object, ...]) -> None:
    if value is not None and value not in choices:
        raise ValueError(f"no {name} {value!r}: one of {', '.join(map(str, choices))}")


def _check_limits(name: str, value: float | None, limits: tuple[float, float], unit: str) -> None:
    if value is not None and not (math.isfinite(value) and limits[0] <= value <= limits[1]):
        raise ValueError(
            f"a {name} lies between {limits[0]:g} and {limits[1]:g} {unit}, not at {value}"
        )
