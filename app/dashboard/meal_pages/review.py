"""The review queue: one item after the other, by keyboard. Events are sent to item_actions.py."""

import uuid
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import HTMLResponse

from app.dashboard.forms import Blank
from app.dashboard.meal_pages.flag_words import reasons_of
from app.dashboard.meal_pages.review_views import (
    Choice,
    Outline,
    choices_of,
    describe_events,
    outline_of,
    why_unmarked,
)
from app.dashboard.page import CurrentPage
from app.http.paging import Cursor
from app.meals.stored.models import MealOrigin
from app.people.access.page_rules import PREFIX
from app.records.review.queries import QUEUED_STATUSES, QueueFilter
from app.records.review.review_items import (
    ReviewItem,
    count_meals_to_look_at,
    count_waiting,
    read_review_item,
    read_review_page,
)

router = APIRouter(include_in_schema=False)

REVIEW = PREFIX + "/studies/{study}/review"
ITEMS_A_PAGE = 12  # one is shown, the others are loaded in advance
ONLY_ITS_INTERVAL = "No reviewer has looked at it; its only doubt is the interval of its amount."
COUNTED = 500  # beyond it: "more than"

DOUBTS = (
    ("", "any"),
    *((str(least), f"{100 * least:.0f} % and more") for least in (0.1, 0.25, 0.5, 0.75, 0.9)),
)
KEYS = (
    (("Enter", "y"), "Confirm the marked food, if one is marked, and go to the next item"),
    (("1", "…", "9"), "Choose this candidate"),
    (("↓", "↑", "n"), "Mark the next or the previous candidate; Enter chooses it"),
    (("f", "/"), "Search for another food"),
    (("m",), "Set the mass in grams"),
    (("v",), "Set the volume in millilitres"),
    (("d",), "Redraw the outline; it is measured again"),
    (("x",), "Reject: it is no food, or nobody ate of it"),
    (("s",), "Skip: the item comes again in the next round"),
    (("c",), "Comment"),
    (("u",), "Undo the last decision, also of an earlier item"),
    (("j", "k"), "Show the next or the previous item"),
    (("o",), "Open the meal's page"),
    (("Esc",), "Leave a field, the drawing or this list"),
)

Status = Annotated[Literal["proposed", "needs_review", "confirmed", "corrected"] | None, Blank]


@dataclass(frozen=True, slots=True)
class Card:
    """An item with everything that its card shows."""

    item: ReviewItem
    outline: Outline | None
    choices: list[Choice]
    unmarked: str  # why no choice is marked in advance; "" if one is
    reasons: list[str]
    new_ids: tuple[uuid.UUID, uuid.UUID]  # ids of the events of its two forms without scripts


@router.get(REVIEW)
def get_review(
    page: CurrentPage,
    status: Status = None,
    food: Annotated[str | None, Query(max_length=100), Blank] = None,
    min_doubt: Annotated[float | None, Query(ge=0, le=1), Blank] = None,
    provisional: Annotated[bool | None, Blank] = None,
    participant: Annotated[str | None, Query(max_length=64), Blank] = None,
    origin: Annotated[MealOrigin | None, Query(), Blank] = None,
    cursor: Cursor = None,
) -> HTMLResponse:
    """The queue from its start; as a fragment the cards after the cursor."""
    chosen = QueueFilter(
        study_id=page.require_study().id,
        status=status,
        food_key=food,
        min_doubt=min_doubt,
        provisional=provisional,
        participant_code=participant,
        origin=origin,
    )
    database = page.state.database
    items = read_review_page(database, chosen, cursor=cursor, limit=ITEMS_A_PAGE)
    waiting = count_waiting(database, chosen, COUNTED + 1)
    return page.render(
        "review_cards.html" if page.is_fragment else "review.html",
        cards=[card_of(item) for item in items.rows],
        more=page.address(cursor=items.cursor) if items.cursor is not None else None,
        waiting=min(waiting, COUNTED),
        is_more=waiting > COUNTED,
        waiting_meals=count_meals_to_look_at(database, chosen.study_id),
        chosen=chosen,
        is_filtered=any(
            value is not None
            for value in (status, food, min_doubt, provisional, participant, origin)
        ),
        statuses=[("", "any"), *((code, code.replace("_", " ")) for code in QUEUED_STATUSES)],
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
    """One item's current card, after somebody else has changed its meal, with their events."""
    current = read_review_item(
        page.state.database, page.study_caller, meal_id, participant, item, seen=seen
    )
    events = describe_events(current.item, current.said, page.caller.staff_id)
    is_rejected = current.item.row.record.status == "rejected"
    return page.render(
        "review_again.html",
        card=card_of(current.item),
        events=events,
        is_settled=is_rejected or any(event.settles and not event.is_own for event in events),
    )


def card_of(item: ReviewItem) -> Card:
    """Return an item's card."""
    choices = choices_of(item)
    unmarked, ids = why_unmarked(item, choices), (uuid.uuid4(), uuid.uuid4())
    reasons = reasons_of(item.row.food, item.row.record.consumed_g, item.row.record.flags) or [
        ONLY_ITS_INTERVAL
    ]
    return Card(item, outline_of(item), choices, unmarked, reasons, ids)
