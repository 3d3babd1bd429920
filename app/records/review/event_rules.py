"""Each kind of event and its rule: the one list of what people may say about a meal."""

from collections.abc import Mapping

from app.records.review import ask, declare_foods, review_item, review_meal, say_leftovers
from app.records.review.meal_events import EventRule

EVENT_RULES: Mapping[str, EventRule] = {
    "confirm": EventRule(review_item.confirm),
    "reject": EventRule(review_item.reject),
    "set_food": EventRule(review_item.set_food),
    "set_volume": EventRule(review_item.set_volume),
    "set_mass": EventRule(review_item.set_mass),
    "set_share": EventRule(review_item.set_share),
    "redraw": EventRule(review_item.redraw),
    "declare": EventRule(declare_foods.declare),
    "add": EventRule(review_meal.add),
    "split": EventRule(review_meal.split),
    "merge": EventRule(review_meal.merge),
    "set_leftover": EventRule(say_leftovers.set_leftover),
    "nothing_left": EventRule(say_leftovers.nothing_left, before_estimate=True),
    "confirm_meal": EventRule(review_meal.confirm_meal),
    "undo": EventRule(review_meal.undo, before_estimate=True),
    "comment": EventRule(ask.comment, before_estimate=True),
    "question": EventRule(ask.question, before_estimate=True, layers=("reviewer",)),
    "answer": EventRule(ask.answer, before_estimate=True, layers=("participant",)),
}
