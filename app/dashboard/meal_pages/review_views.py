"""What a reviewer is shown of an item beside its figures: where it is in the picture, why it waits, what was said."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.foods.models import Food
from app.meals.item_state import FOOD_DOUBTFUL, FOOD_IDENTIFIED, ITEM_DECISIONS
from app.records.review.meal_history import HistoryRow
from app.records.review.review_items import ReviewItem

MARGIN = 0.3  # of the item's larger side, around it
LEAST_SHARE = 0.12  # of the photograph's smaller side: a crumb is shown with what lies around it
SHARP_PX = 900  # so wide a crop is on a good screen
WIDTHS_PX = (1600, 2400, 3200, 4096)  # few, so that a picture is made once and kept
NUMBERED = 9  # candidates that have a key

SETTLING = ITEM_DECISIONS | {"split", "merge", "confirm_meal"}  # a reviewer's word that takes an item out of the queue
EVENT_WORDS = {
    "confirm": "confirmed it",
    "reject": "rejected it",
    "set_food": "set the food",
    "set_volume": "set the volume",
    "set_mass": "set the amount",
    "set_share": "set the share",
    "redraw": "drew it anew",
    "declare": "answered a probe",
    "add": "added a food",
    "split": "split it",
    "merge": "merged items",
    "set_leftover": "said what was left",
    "nothing_left": "said that nothing was left",
    "confirm_meal": "confirmed the whole meal",
    "undo": "took a word back",
    "comment": "wrote a comment",
    "question": "asked a question",
    "answer": "answered a question",
}


@dataclass(frozen=True, slots=True)
class Outline:
    """The item in the left photograph, upright pixels. path: of SVG, holes by the even-odd rule. crop: x, y, w, h.

    corners: of the ring with most of them, where a new drawing begins. served_px: the picture's width that shows the
    crop sharply.
    """

    width_px: int
    height_px: int
    path: str
    crop: tuple[float, float, float, float]
    corners: tuple[tuple[float, float], ...]
    served_px: int


@dataclass(frozen=True, slots=True)
class Choice:
    """A food that the item may be. key: on the keyboard, 1 to 9, or None. is_current: the item is taken for it.

    is_marked: one key takes it, for the reviewer need not choose it first.
    """

    food: Food
    probability: float | None
    source: str
    key: int | None
    is_current: bool
    is_marked: bool


@dataclass(frozen=True, slots=True)
class Said:
    """A word of somebody about the meal, in words. is_of_item: about this item, or about the meal as a whole.

    is_own: of the reader.
    """

    row: HistoryRow
    words: str
    detail: str
    is_of_item: bool
    is_own: bool

    @property
    def settles(self) -> bool:
        """Whether a reviewer has decided the item by it."""
        event = self.row.event
        return self.is_of_item and event.layer == "reviewer" and event.kind in SETTLING and not self.row.is_undone


def outline_of(item: ReviewItem) -> Outline | None:
    """Where the item is; None: the meal has no photograph (any more)."""
    if item.photograph is None:
        return None
    width, height = item.photograph.width_px, item.photograph.height_px
    rings = [[(float(x), float(y)) for x, y in ring] for ring in item.rings if len(ring) > 2]
    crop = crop_of([point for ring in rings for point in ring], width, height)
    wanted = SHARP_PX * width / crop[2]
    most_corners = max(rings, key=len) if rings else []
    return Outline(
        width_px=width,
        height_px=height,
        path=" ".join(_path(ring) for ring in rings),
        crop=crop,
        corners=tuple(most_corners),
        served_px=next((one for one in WIDTHS_PX if one >= min(wanted, width)), WIDTHS_PX[-1]),
    )


def crop_of(points: Sequence[tuple[float, float]], width: int, height: int) -> tuple[float, float, float, float]:
    """A square around the points with a margin, moved into the photograph; all of it where there is no point.

    Points outside the photograph count as on its edge. Returns x, y, width, height; no side is longer than the
    photograph's.
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
    """What the item may be: the food it is taken for first, if no candidate; then the candidates, each food once."""
    current = item.row.food
    foods: dict[str, tuple[Food, float | None, str]] = {}
    candidates = item.candidates.candidates
    if current is not None and all(each.food.key != current.key for each in candidates):
        foods[current.key] = (current, None, "told")
    for each in candidates:
        key = each.food.key
        first = foods.get(key)
        if first is None or (first[1] is None and each.probability is not None):  # the hint's, and then the index's
            foods[key] = (each.food, each.probability, each.source if first is None else first[2])
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


def unmarked_of(item: ReviewItem, choices: Sequence[Choice]) -> str:
    """Why no choice is marked beforehand, in words; "" where one is, or where there is none to mark."""
    if not choices or any(one.is_marked for one in choices):
        return ""
    if item.row.food is not None:
        return "The phone and the server disagree"
    return "Probably none of these" if choices[0].probability is not None else "None of these was said to be it"


def reasons_of(item: ReviewItem) -> list[str]:
    """Why it is where it is in the queue, in words; the doubt itself is the record's (docs/review.md)."""
    record = item.row.record
    reasons = []
    if record.food_id is None:
        reasons.append("Nobody has said what it is, and the server is not sure enough.")
    if record.consumed_g is None:
        reasons.append("How much was eaten is not known.")
    if FOOD_IDENTIFIED in record.flags:
        reasons.append("The server alone says what it is.")
    if FOOD_DOUBTFUL in record.flags:
        reasons.append("The phone's hint and the server disagree about what it is.")
    others = [flag for flag in record.flags if flag not in (FOOD_IDENTIFIED, FOOD_DOUBTFUL)]
    if others:
        reasons.append("The measurement has a cause of doubt: see its flags.")
    if not reasons:
        reasons.append("No reviewer has looked at it; the doubt is that of its amount.")
    return reasons


def said_of(item: ReviewItem, rows: Sequence[HistoryRow], reader: uuid.UUID) -> list[Said]:
    """What was said of the meal, in words; reader: the staff member who reads it."""
    return [
        Said(
            row=row,
            words=EVENT_WORDS.get(row.event.kind, row.event.kind.replace("_", " ")),
            detail=_detail(row.event.new),
            is_of_item=row.event.item_id in (None, item.row.record.item_id),
            is_own=row.event.staff_id == reader,
        )
        for row in rows
    ]


def _detail(new: dict[str, Any]) -> str:
    for name, unit in (("mass_g", " g"), ("volume_ml", " ml")):
        if isinstance(new.get(name), int | float):
            return f"{new[name]:g}{unit}"
    return str(new.get("food") or new.get("text") or "")


def _marked(item: ReviewItem, foods: Mapping[str, tuple[Food, float | None, str]]) -> str | None:
    """Key of the food that is likelier right than wrong, as far as anybody has told; None: the reviewer chooses.

    A reflex takes what is marked, and it goes into a study. The index knows few foods, so that its "none of these" says
    nothing against a food that a person or the phone has named; its being sure of another one does.
    """
    if item.row.food is not None:
        return None if FOOD_DOUBTFUL in item.row.record.flags else item.row.food.key
    first, probability, _ = next(iter(foods.values()), (None, None, ""))
    if first is None or probability is None or probability <= (item.candidates.none_probability or 0.0):
        return None
    return first.key


def _path(ring: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ring) + "Z"
