"""Words between reviewers and a participant: comments, questions to the participant, and the answers to them."""

import uuid

from app.core.errors import ConflictError, NotFoundError
from app.meals.event_values import Answer
from app.meals.item_state import live_events
from app.records.review.meal_events import Change, Standing


def comment(standing: Standing) -> Change:
    """A remark, about an item or the meal; it changes nothing."""
    _check_item(standing)
    return Change(new={"text": standing.event.told["text"]})


def question(standing: Standing) -> Change:
    """Ask the participant; open until it is answered (GET /v1/me/questions)."""
    _check_item(standing)
    return Change(new={"text": standing.event.told["text"]})


def answer(standing: Standing) -> Change:
    """Answer a question. Raises NotFoundError, ConflictError."""
    wanted = uuid.UUID(standing.event.told["question"])
    live = live_events(standing.parts.events)
    if not any(word.event.id == wanted and word.event.kind == "question" for word in live):
        raise NotFoundError("This meal has no such open question.", code="question_not_found")
    if any(isinstance(word.value, Answer) and word.value.question == wanted for word in live):
        raise ConflictError("The question is answered: undo the answer to give another.", code="question_answered")
    return Change(new={"question": str(wanted), "text": standing.event.told["text"]})


def _check_item(standing: Standing) -> None:
    if standing.event.item_id is not None:
        standing.item()
