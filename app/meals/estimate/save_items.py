"""Save the items that a run found, with the foods of their hints, or those that the index is sure of."""

import uuid
from collections.abc import Sequence

from sqlalchemy.orm import Session

from app.candidates.item_candidates import save_candidates
from app.foods import queries as foods
from app.foods.models import Food
from app.meals.stored.meal_parts import FROM_HINT
from app.meals.stored.models import HintDetails, Meal
from app.meals.stored.outline_json import rings_of
from app.meals.stored.record_models import HintedLeftover, Item, ItemCandidate, ItemFood, ItemOrigin
from app.meals.stored.run_answer import ItemAnswer
from app.records.item_foods import item_food, weighing_for

ITEM_NAMESPACE = uuid.UUID(
    "3f2ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e"
)  # drawn once; item ids are derived under it

Numbered = Sequence[tuple[int, ItemAnswer]]  # items of an answer with their positions in it


def save_served(session: Session, meal: Meal, run_id: uuid.UUID, answers: Numbered) -> None:
    """Save items of the meal's own pair, with the foods of their hints, else those that the index is sure of."""
    items = [_item_row(meal.id, run_id, position, answer) for position, answer in answers]
    hints = _hint_of_each(answers, meal.details["hints"])
    _save_items(session, meal, items, hints)
    seen = [(item, answer) for item, (_, answer) in zip(items, answers, strict=True)]
    likely = save_candidates(session, run_id, seen)
    for item, hint, food in zip(items, hints, likely, strict=True):
        row = (
            _food_assignment(session, meal, item, food, hint.get("lies_as"))
            if "food" not in hint
            else None
        )
        if row is not None:
            session.add(row)


def save_left(session: Session, meal: Meal, run_id: uuid.UUID, answers: Numbered) -> None:
    """Save items of the after-meal pair. They are matched to the meal's items when the meal is projected."""
    items = [_item_row(meal.id, run_id, position, answer, "after") for position, answer in answers]
    hints = _hint_of_each(answers, after_hints(meal))
    for item, hint in zip(items, hints, strict=True):
        item.traits = {**item.traits, "told": _hinted_leftover(hint)}
    _save_items(session, meal, items, hints)


def after_hints(meal: Meal) -> list[HintDetails]:
    """Return the hints of the after-meal pair, as the phone sent them."""
    return meal.after_details["hints"] if meal.after_details is not None else []


def _item_row(
    meal_id: uuid.UUID,
    run_id: uuid.UUID,
    position: int,
    answer: ItemAnswer,
    origin: ItemOrigin = "pipeline",
) -> Item:
    """Return the row of an item of the answer. Its id follows from run and position, so a rebuilt row has the same."""
    low_ml, high_ml = answer.interval_ml
    return Item(
        id=uuid.uuid5(ITEM_NAMESPACE, f"{run_id}/{position}"),
        meal_id=meal_id,
        run_id=run_id,
        origin=origin,
        position=position,
        rings=rings_of(answer.polygon),
        volume_ml=answer.volume_ml,
        volume_low_ml=low_ml,
        volume_high_ml=high_ml,
        relative_sd=answer.relative_sd,
        flags=answer.flags,
        traits=answer.traits,
    )


def _hinted_leftover(hint: HintDetails) -> HintedLeftover:
    hinted: HintedLeftover = {}
    if "item" in hint:
        hinted["item"] = hint["item"]
    if "class" in hint:
        hinted["class"] = hint["class"]
    return hinted


def _hint_of_each(answers: Numbered, hints: Sequence[HintDetails]) -> list[HintDetails]:
    """Return the hint that each item answers; empty if it answers none."""
    return [hints[item.hint] if item.hint is not None else {} for _, item in answers]


def _save_items(
    session: Session, meal: Meal, items: Sequence[Item], hints: Sequence[HintDetails]
) -> None:
    """Save items with the foods of their hints."""
    session.add_all(items)
    session.flush()
    chosen = _chosen_foods(session, hints)
    session.add_all(
        ItemCandidate(
            item_id=item.id, position=0, food_id=food.id, probability=None, source=FROM_HINT
        )
        for item, food in zip(items, chosen, strict=True)
        if food is not None
    )
    assignments = [
        _food_assignment(session, meal, item, food, hint.get("lies_as"))
        for item, food, hint in zip(items, chosen, hints, strict=True)
    ]
    session.add_all(row for row in assignments if row is not None)


def _chosen_foods(session: Session, hints: Sequence[HintDetails]) -> list[Food | None]:
    """Return the food of each item's hint; None without a hint or if no table has the food."""
    keys = {hint["food"] for hint in hints if "food" in hint}
    foods_by_key = foods.foods_by_key(session, keys) if keys else {}
    return [foods_by_key.get(hint.get("food", "")) for hint in hints]


def _food_assignment(
    session: Session, meal: Meal, item: Item, food: Food | None, lies_as: str | None
) -> ItemFood | None:
    if food is None:
        return None
    return item_food(item.id, food.id, weighing_for(session, food, meal.study_id, lies_as), lies_as)
