"""Limits of possible figures in 100 g of food, and of a plausible energy in a day.

A reported energy is judged by its ratio to the basal metabolic rate (Goldberg cut-offs). A person
of stable weight spends, and eats, their basal metabolic rate times their physical activity level
(PAL). A mean of d days outside the 95 % limits of that is unlikely to be the habitual intake: meals
were left out (low), or too much was reported (high). It judges the report, not the person, and
detects only gross misreporting.

Goldberg et al. 1991 (Eur J Clin Nutr 45:569), with the variations of Black 2000 (Int J Obes
24:1119):

    limits = PAL exp(-+ 2 S / 100),  S = sqrt(CVwEI^2 / d + CVwB^2 + CVtP^2)
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from app.core.units import Unit, convert
from app.nutrition.components import COMPONENT_BY_NUMBER, NUMBER_BY_TAGNAME, Component
from app.nutrition.intakes.energy_requirement import Activity, Energy, LeftOut

# of the macronutrients in 100 g: analysed separately, those of a salmon in SR28 add up to 106.5
LARGEST_SUM_G = 107.0
LARGEST_ENERGY_KCAL = 930.0  # of 100 g; pure fat has 902 in SR28
# spun sugar has some ten times the minimum, crystals of salt 2.2
MIN_G_PER_ML, MAX_G_PER_ML = 0.005, 3.0

_CARBOHYDRATE = ("205", "205.2", "CHOAVLDF", "CHOAVL")  # one of them, the most inclusive first
_OTHERS = tuple(NUMBER_BY_TAGNAME[tagname] for tagname in ("WATER", "PROCNT", "FAT", "ASH", "ALC"))
_MASSES = (Unit.G, Unit.MG, Unit.UG)
_ENERGIES = (Unit.KCAL, Unit.KJ)
CV_ENERGY_WITHIN_PERCENT = 23.0  # CVwEI: of one person's energy intake, day to day
CV_BASAL_RATE_PERCENT = 8.5  # CVwB: of a basal metabolic rate by equation
CV_ACTIVITY_PERCENT = 15.0  # CVtP: of the physical activity level between people
SD_LIMITS = 2.0  # 95 % limits
ADULT_YEARS = 18.0  # the cut-offs and their variations are for adults

USUAL_PAL = 1.55  # if the activity is not known: the light activity that Goldberg et al. assume
PAL: Mapping[Activity, float] = {  # IOM 2002/2005: the levels that stand for its four classes
    "sedentary": 1.25,
    "low_active": 1.5,
    "active": 1.75,
    "very_active": 2.2,
}

Verdict = Literal["low", "plausible", "high", "unknown"]
WhyUnknown = Literal["profile_unknown", "no_whole_day", "basal_rate_unknown", "not_an_adult"]


def most_in_100_g(component: Component) -> float:
    """Return the maximum content of a component in 100 g of any food, in its unit; infinite for international units."""
    if component.unit in _MASSES:
        return convert(100.0, Unit.G, component.unit)
    if component.unit in _ENERGIES:
        return convert(LARGEST_ENERGY_KCAL, Unit.KCAL, component.unit)
    return math.inf


def why_impossible(per_100_g: Mapping[str, float]) -> str | None:
    """Return why these contents are impossible, as a sentence; None if possible.

    Unknown contents count as 0.
    """
    for number, content in per_100_g.items():
        component = COMPONENT_BY_NUMBER.get(number)
        if component is not None and content > most_in_100_g(component):
            if component.unit in _ENERGIES:
                return f"100 g have {content:g} {component.unit}, more than pure fat: is it another unit?"
            return f"100 g hold {content:g} {component.unit} of {component.name.lower()}, more than there is."
    carbohydrate = next((per_100_g[number] for number in _CARBOHYDRATE if number in per_100_g), 0.0)
    total = math.fsum([carbohydrate, *(per_100_g.get(number, 0.0) for number in _OTHERS)])
    if total > LARGEST_SUM_G:
        return (
            f"Water, protein, fat, carbohydrate, ash and alcohol of 100 g add up to {total:.1f} g."
        )
    return None


@dataclass(frozen=True, slots=True)
class Plausibility:
    """A verdict with its basis. If it is "unknown", reason says why and the numbers may be None.

    ratio: energy intake / basal metabolic rate; low, high: the limits within which it is plausible.
    """

    verdict: Verdict
    days: int
    ratio: float | None = None
    low: float | None = None
    high: float | None = None
    reason: WhyUnknown | None = None


def cut_offs(days: int, pal: float = USUAL_PAL) -> tuple[float, float]:
    """Return the 95 % limits of energy intake / basal metabolic rate for one person's mean of `days` days.

    Raises ValueError for less than one day or a PAL that is not positive.
    """
    if days < 1 or not 0.0 < pal < math.inf:
        raise ValueError(
            f"limits need at least one day and a positive activity level, not {days} and {pal}"
        )
    spread_percent = math.sqrt(
        CV_ENERGY_WITHIN_PERCENT**2 / days + CV_BASAL_RATE_PERCENT**2 + CV_ACTIVITY_PERCENT**2
    )
    factor = math.exp(SD_LIMITS * spread_percent / 100.0)
    return pal / factor, pal * factor


def judge_energy(
    energy_kcal: float | None,
    days: int,
    basal_rate: Energy | LeftOut,
    *,
    age_years: float | None,
    activity: Activity | None = None,
) -> Plausibility:
    """Judge a mean daily energy (kcal) of `days` whole days.

    basal_rate: kcal a day, of the same person (energy_requirement.py).
    """
    if energy_kcal is None or days < 1:
        return Plausibility("unknown", days, reason="no_whole_day")
    if isinstance(basal_rate, LeftOut):
        return Plausibility("unknown", days, reason="basal_rate_unknown")
    if age_years is None or age_years < ADULT_YEARS:
        return Plausibility("unknown", days, reason="not_an_adult")
    ratio = energy_kcal / basal_rate.kcal_per_day
    low, high = cut_offs(days, USUAL_PAL if activity is None else PAL[activity])
    verdict: Verdict = "low" if ratio < low else "high" if ratio > high else "plausible"
    return Plausibility(verdict, days, ratio, low, high)
