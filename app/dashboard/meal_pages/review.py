"""The review queue: one item after the other, by keyboard. Events are sent to item_actions.py."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import HTMLResponse

from app.dashboard.forms import Blank
from app.dashboard.meal_pages.flag_words import reasons_of
from app.dashboard.page import CurrentPage
from app.foods.models import Food
from app.http.paging import Cursor
from app.meals.stored.item_state import FOOD_DOUBTFUL, ITEM_DECISIONS
from app.meals.stored.meal_parts import FROM_MODEL
from app.meals.stored.models import MealOrigin
from app.people.access.page_rules import PREFIX
from app.records.review.meal_history import HistoryRow
from app.records.review.queries import QUEUED_STATUSES, QueueFilter
from app.records.review.review_items import (
    ReviewItem,
    count_meals_to_look_at,
    count_waiting,
    read_review_item,
    read_review_page,
)

MARGIN = 0.3  # of the item's larger side, around it
LEAST_SHARE = 0.12  # of the photograph's smaller side: a crumb is shown with its surroundings
SHARP_PX = 900  # width of a crop on a good screen
WIDTHS_PX = (1600, 2400, 3200, 4096)  # few, so that pictures are cached
NUMBERED = 9  # candidates that have a key

# reviewers' events that take an item out of the queue
SETTLING = ITEM_DECISIONS | {"split", "merge", "confirm_meal"}
ACTIONS = {
    "confirm": "confirmed it",
    "reject": "rejected it",
    "set_food": "set the food",
    "set_volume": "set the volume",
    "set_mass": "set the amount",
    "set_share": "set the share",
    "redraw": "redrew it",
    "reshape": "shaped it by hand",
    "declare": "answered a probe",
    "add": "added a food",
    "split": "split it",
    "merge": "merged items",
    "set_leftover": "set what was left",
    "nothing_left": "stated that nothing was left",
    "confirm_meal": "confirmed the whole meal",
    "undo": "undid an event",
    "comment": "wrote a comment",
    "question": "asked a question",
    "answer": "answered a question",
}
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
class Outline:
    """The item in the left photograph, in upright pixels.

    path: of SVG, holes by the even-odd rule. crop: x, y, w, h.

    corners: of the ring with the most, from which a new drawing starts. served_px: the photograph's
    width at which the crop is sharp.
    """

    width_px: int
    height_px: int
    path: str
    crop: tuple[float, float, float, float]
    corners: tuple[tuple[float, float], ...]
    served_px: int


@dataclass(frozen=True, slots=True)
class Choice:
    """A food that the item may be.

    key: on the keyboard, 1 to 9, or None. is_current: it is the item's food.

    is_marked: Enter confirms it; the reviewer need not choose it first.
    """

    food: Food
    probability: float | None
    source: str
    key: int | None
    is_current: bool
    is_marked: bool


@dataclass(frozen=True, slots=True)
class RecentEvent:
    """An event of the meal, described.

    is_of_item: about this item or the whole meal. is_own: by the reader.
    """

    row: HistoryRow
    action: str
    detail: str
    is_of_item: bool
    is_own: bool

    @property
    def settles(self) -> bool:
        """Whether a reviewer decided the item with it."""
        event = self.row.event
        return (
            self.is_of_item
            and event.layer == "reviewer"
            and event.kind in SETTLING
            and not self.row.is_undone
        )


def outline_of(item: ReviewItem) -> Outline | None:
    """Return where the item is; None if the meal has no photograph."""
    if item.photograph is None:
        return None
    return outline_in(item.photograph.width_px, item.photograph.height_px, item.rings)


def outline_in(width: int, height: int, outline: Sequence[Sequence[Sequence[float]]]) -> Outline:
    """Return where an outline is in a picture of this size."""
    rings = [[(float(x), float(y)) for x, y in ring] for ring in outline if len(ring) > 2]
    crop = crop_of([point for ring in rings for point in ring], width, height)
    sharp_width = SHARP_PX * width / crop[2]
    most_corners = max(rings, key=len) if rings else []
    return Outline(
        width_px=width,
        height_px=height,
        path=" ".join(_path(ring) for ring in rings),
        crop=crop,
        corners=tuple(most_corners),
        served_px=next(
            (served for served in WIDTHS_PX if served >= min(sharp_width, width)), WIDTHS_PX[-1]
        ),
    )


def crop_of(
    points: Sequence[tuple[float, float]], width: int, height: int
) -> tuple[float, float, float, float]:
    """Return x, y, width, height of a square around the points with a margin, moved into the photograph.

    Points outside the photograph are moved to its edge; no side is longer than the photograph's.
    Without points it is the whole photograph.
    """
    if not points:
        return (0.0, 0.0, float(width), float(height))
    xs = [min(max(x, 0.0), float(width)) for x, _ in points]
    ys = [min(max(y, 0.0), float(height)) for _, y in points]
    side = max(max(xs) - min(xs), max(ys) - min(ys)) * (1.0 + 2.0 * MARGIN)
    side = max(side, LEAST_SHARE * min(width, height))
    across, down = min(side, float(width)), min(side, float(height))
    left = (min(xs) + max(xs) - across) / 2.0
    top = (min(ys) + max(ys) - down) / 2.0
    return (min(max(left, 0.0), width - across), min(max(top, 0.0), height - down), across, down)


def choices_of(item: ReviewItem) -> list[Choice]:
    """Return the candidates, each food once; the item's food first if it is no candidate."""
    current = item.row.food
    foods: dict[str, tuple[Food, float | None, str]] = {}
    candidates = item.candidates.candidates
    if current is not None and all(candidate.food.key != current.key for candidate in candidates):
        foods[current.key] = (current, None, "person")
    for candidate in candidates:
        key, probability = candidate.food.key, candidate.probability
        first = foods.get(key)
        # the hint's, then the index's
        if first is None or (first[1] is None and probability is not None):
            foods[key] = (
                candidate.food,
                probability,
                candidate.source if first is None else first[2],
            )
    marked = _marked(item, foods)
    return [
        Choice(
            food,
            probability,
            source,
            number if number <= NUMBERED else None,
            is_current=current is not None and key == current.key,
            is_marked=key == marked,
        )
        for number, (key, (food, probability, source)) in enumerate(foods.items(), 1)
    ]


def why_unmarked(item: ReviewItem, choices: Sequence[Choice]) -> str:
    """Return why no choice is marked in advance; "" if one is, or if there is none."""
    if not choices or any(choice.is_marked for choice in choices):
        return ""
    if item.row.food is not None:
        return "The phone and the server disagree"
    return (
        "Probably none of these"
        if choices[0].probability is not None
        else "None of these was stated"
    )


def describe_events(
    item: ReviewItem, rows: Sequence[HistoryRow], reader: uuid.UUID
) -> list[RecentEvent]:
    """Describe the meal's events. reader: the staff member who reads them."""
    return [
        RecentEvent(
            row=row,
            action=ACTIONS.get(row.event.kind, row.event.kind.replace("_", " ")),
            detail=_detail(row.event.new),
            is_of_item=row.event.item_id in (None, item.row.record.item_id),
            is_own=row.event.staff_id == reader,
        )
        for row in rows
    ]


def _detail(new: Mapping[str, object]) -> str:
    for name, unit in (("mass_g", " g"), ("volume_ml", " ml")):
        if isinstance(value := new.get(name), int | float):
            return f"{value:g}{unit}"
    return str(new.get("food") or new.get("text") or "")


def _marked(item: ReviewItem, foods: Mapping[str, tuple[Food, float | None, str]]) -> str | None:
    """Return the key of the food that is more likely right than wrong; None: the reviewer has to choose.

    A reviewer may confirm a marked food by reflex. The index knows few foods, so its "none of
    these" is no evidence against a food that a person or the phone has named; its certainty about
    another food is. An operator's network alone marks nothing: nobody knows how honest its
    probabilities are.
    """
    if item.row.food is not None:
        return None if FOOD_DOUBTFUL in item.row.record.flags else item.row.food.key
    first, probability, source = next(iter(foods.values()), (None, None, ""))
    if (
        first is None
        or probability is None
        or source == FROM_MODEL
        or probability <= (item.candidates.none_probability or 0.0)
    ):
        return None
    return first.key


def _path(ring: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ring) + "Z"


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
    database = page.database
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
        page.database, page.study_caller, meal_id, participant, item, seen=seen
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
