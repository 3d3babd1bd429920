"""What a participant is still to be asked of the foods of a meal, since no camera sees it."""

import uuid

from app.meals.item_state import MealState
from app.records.project_records import Projector


def open_probes(projector: Projector, meal: MealState) -> dict[uuid.UUID, tuple[str, ...]]:
    """Item -> the probes of its food that nobody has answered; of items that count only."""
    found = {}
    for state in meal.items:
        if state.is_live and state.taken_for is not None:
            asked = projector.food(state.taken_for.food_id).probes
            found[state.item.id] = tuple(probe for probe in asked if probe not in meal.answers[state.item.id])
    return found
