"""Flag a run whose marker was probably declared at a wrong size, judged by what stands around it."""

import math
from collections.abc import Sequence
from typing import cast

from app.candidates.vcm_json import numbers_of
from app.identification.identifier import Identifier
from app.identification.scale import MeasuredFood, plausible_factor
from app.identification.sizes import FoodSize
from app.meals.stored.item_state import SCALE_DOUBTFUL
from app.meals.stored.models import HintDetails, Meal
from app.meals.stored.run_answer import ItemAnswer, RunAnswer

# a parameter of the run: what all lengths should be multiplied by
PLAUSIBLE_FACTOR = "plausible_scale_factor"


def note_doubtful_scale(meal: Meal, answer: RunAnswer, identifier: Identifier) -> None:
    """Flag the items, and note the factor, where the sizes of dishes and foods contradict the marker's."""
    if answer.parameters.get("scale_source") != "marker":
        return
    lengths_mm = dict(cast(dict[str, list[float]], answer.parameters.get("rim_radii_mm", {})))
    lengths_mm["camera"] = [cast(float, answer.parameters["camera_height_first_mm"])]
    hints = (
        meal.details["hints"] if not answer.regions else []
    )  # a run on redrawn regions has hints of its own
    foods = [
        MeasuredFood(
            item.volume_ml, math.hypot(*item.relative_sd.values()), _kinds(item, hints, identifier)
        )
        for item in answer.items
        if item.volume_ml
    ]
    factor = plausible_factor(lengths_mm, foods)
    if factor is not None:
        answer.parameters[PLAUSIBLE_FACTOR] = round(factor, 2)
        for item in answer.items:
            item.flags.append(SCALE_DOUBTFUL)


def _kinds(
    item: ItemAnswer, hints: Sequence[HintDetails], identifier: Identifier
) -> list[tuple[float, FoodSize]]:
    """The foods of known size that an item may be: the one that its hint names, else by its looks."""
    food = hints[item.hint].get("food") if hints and item.hint is not None else None
    if food is not None:
        size = identifier.size_of(food)
        return [(1.0, size)] if size is not None else []
    if item.vcm is None or item.vcm.version != identifier.vcm_version:
        return []
    return identifier.sizes_by_looks(numbers_of(item.vcm.vector))
