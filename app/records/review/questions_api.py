"""/v1/me/questions: what reviewers want to know of the participant."""

from fastapi import APIRouter

from app.http.problems import problem_responses
from app.people.access.deps import CurrentDevice, State
from app.records.review.queue_schemas import QuestionList, QuestionOut
from app.records.review.review_queue import open_questions

router = APIRouter(prefix="/v1/me", tags=["review"])


@router.get("/questions", responses=problem_responses(401, 403))
def get_questions(state: State, caller: CurrentDevice) -> QuestionList:
    """Questions that wait for an answer: an event of kind `answer` of the meal."""
    return QuestionList(
        items=[
            QuestionOut(
                id=event.id,
                meal=meal.client_id,
                item=event.item_id,
                text=event.new["text"],
                asked_at=event.created_at,
                captured_at=meal.captured_at,
                local_date=meal.local_date,
                etag=f'"{meal.version}"',
            )
            for event, meal in open_questions(state.database, caller)
        ]
    )
