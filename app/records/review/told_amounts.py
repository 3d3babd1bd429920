"""How much a person tells: grams, millilitres or household measures, with how far off they may be.

The relative standard deviations stand in for a person who does not say how sure they are. A kitchen scale is better, a
memory worse; an app that knows sends its own.
"""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.foods.models import Food

TOLD_SD = 0.1  # grams or millilitres that somebody looks at while they set them
PORTION_SD = 0.2  # a household measure: level or heaped
DECLARED_SD = 0.25  # what nobody sees any more


def told_amount(
    session: Session, told: Mapping[str, Any] | None, food: Food | None, default_sd: float
) -> dict[str, Any]:
    """An amount of the API (`AmountIn`) as an event keeps it: mass_g and of, or volume_ml; relative_sd; empty for None.

    A household measure is kept with the key of its food (portion_of): of another food its grams say nothing.
    food: whose household measures count. Raises InvalidInputError (`portion_unknown`) where it has none of that name.
    """
    if told is None:
        return {}
    given = {name: value for name, value in told.items() if value is not None}
    relative_sd = given.get("relative_sd")
    if "portion" in given:
        sd = max(default_sd, PORTION_SD) if relative_sd is None else relative_sd
        one_g, key = _portion(session, food, given["portion"])
        return {
            "mass_g": one_g * given["count"], "of": "edible", "relative_sd": sd,
            "portion": given["portion"], "count": given["count"], "portion_of": key,
        }  # fmt: skip
    sd = default_sd if relative_sd is None else relative_sd
    if "mass_g" in given:
        return {"mass_g": given["mass_g"], "of": given.get("of", "as_seen"), "relative_sd": sd}
    return {"volume_ml": given["volume_ml"], "relative_sd": sd}


def _portion(session: Session, food: Food | None, measure: str) -> tuple[float, str]:
    """Edible grams of one such measure of the food, and the food's key."""
    known = foods.portions_of(session, food.id) if food is not None else []
    for portion in known:
        if food is not None and portion.measure == measure:
            return portion.mass_g / portion.amount, food.key
    raise InvalidInputError(
        "The food has no such household measure: send one of `portions` of GET /v1/foods/{key}, or grams.",
        code="portion_unknown",
        portions=[portion.measure for portion in known],
    )
