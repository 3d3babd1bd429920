"""Flag a run whose marker was probably declared at another size than it has, by what stands around it."""

import math
from typing import cast

from app.candidates.vcm_json import numbers_of
from app.identification.identifier import Identifier
from app.identification.scale import MeasuredFood, MeasuredSizes, plausible_factor
from app.identification.sizes import FoodSize
from app.meals.item_state import SCALE_DOUBTFUL
from app.meals.models import Meal
from app.meals.run_answer import ItemAnswer, RunAnswer

DISHES = ("plate", "bowl", "cup")
PLAUSIBLE_FACTOR = "plausible_scale_factor"  # the run's parameter: of lengths, 0.5 where the marker is half as large


def note_doubtful_scale(meal: Meal, answer: RunAnswer, identifier: Identifier) -> None:
    """Flag the answer's items, and tell the factor, where the sizes of dishes and foods speak against the marker's."""
    if answer.parameters.get("scale_source") != "marker":
        return
    lengths_mm = {kind: cast(list[float], answer.parameters.get(f"{kind}_radii_mm", [])) for kind in DISHES}
    if "camera_height_first_mm" in answer.parameters:
        lengths_mm["camera"] = [cast(float, answer.parameters["camera_height_first_mm"])]
    foods = [
        MeasuredFood(item.volume_ml, math.hypot(*item.relative_sd.values()), _kinds(meal, answer, item, identifier))
        for item in answer.items
        if item.volume_ml is not None
    ]
    factor = plausible_factor(MeasuredSizes(lengths_mm, foods))
    if factor is not None:
        answer.parameters[PLAUSIBLE_FACTOR] = round(factor, 2)
        for item in answer.items:
            item.flags.append(SCALE_DOUBTFUL)


def _kinds(meal: Meal, answer: RunAnswer, item: ItemAnswer, identifier: Identifier) -> list[tuple[float, FoodSize]]:
    """The foods of known size that an item may be: the one that its hint names, else by its looks."""
    hints = meal.details["hints"] if not answer.regions else []  # a run on redrawn regions has hints of its own
    food = hints[item.hint].get("food") if hints and item.hint is not None else None
    if food is not None:
        size = identifier.size_of(food)
        return [(1.0, size)] if size is not None else []
    if item.vcm is None or item.vcm.version != identifier.vcm_version:
        return []
    return identifier.sizes_by_looks(numbers_of(item.vcm.vector))
