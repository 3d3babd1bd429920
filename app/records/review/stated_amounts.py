"""Amounts that people state: grams, millilitres or household measures, each with its uncertainty.

The relative standard deviations apply where the sender states none. A kitchen scale is better, memory is worse; an app
that knows sends its own.
"""

from typing import Literal, TypedDict

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.foods.models import Food
from app.records.review.schemas import AmountIn

STATED_SD = 0.1  # grams or millilitres set while looking at the food
PORTION_SD = 0.2  # a household measure: level or heaped
DECLARED_SD = 0.25  # stated from memory


class StatedAmount(TypedDict, total=False):
    """An amount as an event stores it: mass_g and of, or volume_ml, with relative_sd; empty: none was stated.

    portion_of: key of the food whose household measure was stated; the grams hold for no other food.
    """

    mass_g: float
    of: Literal["as_seen", "edible"]
    volume_ml: float | None
    relative_sd: float
    portion: str
    count: float
    portion_of: str


def stated_amount(
    session: Session, amount: AmountIn | None, food: Food | None, default_sd: float
) -> StatedAmount:
    """Convert an amount of the API to its stored form. food: the food whose household measures apply.

    Raises InvalidInputError (`portion_unknown`) if the food has no household measure of that name.
    """
    if amount is None:
        return {}
    sd = default_sd if amount.relative_sd is None else amount.relative_sd
    if amount.portion is not None and amount.count is not None:
        portion_g, food_key = _portion(session, food, amount.portion)
        return {
            "mass_g": portion_g * amount.count,
            "of": "edible",
            "relative_sd": max(default_sd, PORTION_SD) if amount.relative_sd is None else sd,
            "portion": amount.portion,
            "count": amount.count,
            "portion_of": food_key,
        }
    if amount.mass_g is not None:
        return {"mass_g": amount.mass_g, "of": amount.of or "as_seen", "relative_sd": sd}
    return {"volume_ml": amount.volume_ml, "relative_sd": sd}


def _portion(session: Session, food: Food | None, measure: str) -> tuple[float, str]:
    """Return the edible grams of one such measure of the food, and the food's key."""
    portions = foods.portions_of(session, food.id) if food is not None else []
    for portion in portions:
        if food is not None and portion.measure == measure:
            return portion.mass_g / portion.amount, food.key
    raise InvalidInputError(
        "The food has no such household measure: send one of `portions` of GET /v1/foods/{key}, or grams.",
        code="portion_unknown",
        portions=[portion.measure for portion in portions],
    )
