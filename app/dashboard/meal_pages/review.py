"""The review queue: one item after the other, worked by keyboard. What is said goes the way of item_actions.py."""

import uuid
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BeforeValidator
from starlette.responses import HTMLResponse

from app.core.errors import NotFoundError
from app.dashboard.meal_pages.review_views import (
    Choice,
    Outline,
    choices_of,
    outline_of,
    reasons_of,
    said_of,
    unmarked_of,
)
from app.dashboard.one_study import in_study
from app.dashboard.page import CurrentPage
from app.http.paging import Cursor
from app.people.access.page_rules import PREFIX
from app.records.review.queries import QUEUED_STATUSES, QueueFilter
from app.records.review.review_items import ReviewItem, count_waiting, read_review_item, read_review_page

router = APIRouter(include_in_schema=False)

REVIEW = PREFIX + "/studies/{study}/review"
ITEMS_A_PAGE = 12  # one is shown; the others are there before they are asked for
COUNTED = 500  # beyond it: "more than"

DOUBTS = (("", "any"), *((str(least), f"{100 * least:.0f} % and more") for least in (0.1, 0.25, 0.5, 0.75, 0.9)))
KEYS = (
    (("Enter", "y"), "Confirm: the food that is marked, none where none is likely; then the next item is there"),
    (("1", "…", "9"), "It is this candidate"),
    (("↓", "↑", "n"), "Mark the next candidate, or the one before; Enter takes it"),
    (("f", "/"), "Search for another food"),
    (("m",), "Set the mass in grams"),
    (("v",), "Set the volume in millilitres"),
    (("d",), "Draw the outline anew; it is measured again"),
    (("x",), "Reject: no food, or nobody ate of it"),
    (("s",), "Skip: says nothing; it comes again in the next round"),
    (("c",), "Comment"),
    (("u",), "Undo the last decision, also of an item before"),
    (("j", "k"), "Look at the next item, at the one before"),
    (("o",), "Open the meal's page"),
    (("Esc",), "Leave a field, the drawing or this list"),
)

# a form sends a field that says nothing as ""
Blank = BeforeValidator(lambda told: None if isinstance(told, str) and not told.strip() else told)
Status = Annotated[Literal["proposed", "needs_review", "confirmed", "corrected"] | None, Blank]


@dataclass(frozen=True, slots=True)
class Card:
    """An item with all that its card shows."""

    item: ReviewItem
    outline: Outline | None
    choices: list[Choice]
    unmarked: str  # why none of the choices is marked beforehand; "" where one is
    reasons: list[str]
    new_ids: tuple[uuid.UUID, uuid.UUID]  # of the words that its two forms say where no script runs


@router.get(REVIEW)
def get_review(
    page: CurrentPage,
    status: Status = None,
    food: Annotated[str | None, Query(max_length=100), Blank] = None,
    min_doubt: Annotated[float | None, Query(ge=0, le=1), Blank] = None,
    provisional: Annotated[bool | None, Blank] = None,
    participant: Annotated[str | None, Query(max_length=64), Blank] = None,
    cursor: Cursor = None,
) -> HTMLResponse:
    """The queue from its head; a script that asks for a part gets the cards behind the cursor."""
    if page.study is None:
        raise NotFoundError("There is no such study.")
    chosen = QueueFilter(
        study_id=page.study.id,
        status=status,
        food_key=food,
        min_doubt=min_doubt,
        provisional=provisional,
        participant_code=participant,
    )
    database = page.state.database
    found = read_review_page(database, chosen, cursor=cursor, limit=ITEMS_A_PAGE)
    waiting = count_waiting(database, chosen, COUNTED + 1)
    return page.render(
        "review_cards.html" if page.is_fragment else "review.html",
        cards=[card_of(item) for item in found.rows],
        more=page.address(cursor=found.cursor) if found.cursor is not None else None,
        waiting=min(waiting, COUNTED),
        is_more=waiting > COUNTED,
        chosen=chosen,
        is_filtered=any(one is not None for one in (status, food, min_doubt, provisional, participant)),
        statuses=[("", "any"), *((one, one.replace("_", " ")) for one in QUEUED_STATUSES)],
        doubts=DOUBTS,
        key_table=KEYS,
    )


@router.get(REVIEW + "/{participant}/{meal_id}")
def get_item(
    page: CurrentPage,
    participant: str,
    meal_id: uuid.UUID,
    item: Annotated[uuid.UUID, Query()],
    seen: Annotated[int, Query(ge=0)] = 0,
) -> HTMLResponse:
    """One item as it stands: shown anew after somebody else has changed its meal, with what they said."""
    now = read_review_item(page.state.database, in_study(page), meal_id, participant, item, seen=seen)
    said = said_of(now.item, now.said, page.caller.staff_id)
    is_over = now.item.row.record.status == "rejected"
    return page.render(
        "review_again.html",
        card=card_of(now.item),
        said=said,
        is_settled=is_over or any(each.settles and not each.is_own for each in said),
    )


def card_of(item: ReviewItem) -> Card:
    """An item as the template shows it."""
    choices = choices_of(item)
    unmarked, ids = unmarked_of(item, choices), (uuid.uuid4(), uuid.uuid4())
    return Card(item, outline_of(item), choices, unmarked, reasons_of(item), ids)
