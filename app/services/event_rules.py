"""Each kind of event and its rule: the one list of what people may say about a meal."""

from collections.abc import Mapping

from app.services import ask
from app.services.meal_events import EventRule

EVENT_RULES: Mapping[str, EventRule] = {
    "comment": EventRule(ask.comment, before_estimate=True),
    "question": EventRule(ask.question, before_estimate=True, layers=("reviewer",)),
    "answer": EventRule(ask.answer, before_estimate=True, layers=("participant",)),
}
