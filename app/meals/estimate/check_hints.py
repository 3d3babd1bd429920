"""Check a phone's hints: vessels of the study's library, foods of a table in force, places within the photograph.

An impossible hint is refused while the app can still correct it. A hint that is merely wrong is
kept and its item is flagged (`hint_missed`); so is a hint whose photograph arrives after it.
"""

import uuid
from collections.abc import Iterator, Sequence

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.meals.stored.models import HintDetails, MealImage
from app.meals.stored.outline_json import rings_of
from app.meals.stored.receive_photo import SealablePhoto
from app.vessels.meal_vessels import require_known_vessels


def require_valid_hints(
    session: Session,
    study_id: uuid.UUID,
    hints: Sequence[HintDetails],
    photo: SealablePhoto | MealImage | None,
) -> None:
    """Raise InvalidInputError (`vessel_unknown`, `food_unknown`, `hint_outside`) for the first hint that cannot be.

    photo: the one that the hints point at; None: it has not arrived, so their places are not
    checked.
    """
    require_known_vessels(session, study_id, hints)
    keys = {hint["food"] for hint in hints if hint.get("food")}
    unknown = sorted(keys - set(foods.foods_by_key(session, keys))) if keys else []
    if unknown:
        raise InvalidInputError(
            f"No food table in force has {', '.join(unknown)}: GET /v1/foods lists the foods that there are.",
            code="food_unknown",
            foods=unknown,
        )
    if photo is not None:
        _require_within(hints, photo.width_px, photo.height_px)


def _require_within(hints: Sequence[HintDetails], width_px: int, height_px: int) -> None:
    outside = [
        number
        for number, hint in enumerate(hints)
        for left, top, right, bottom in _bounds(hint)
        if left > width_px or top > height_px or right < 0 or bottom < 0
    ]
    if outside:
        raise InvalidInputError(
            f"Hint {outside[0]} lies outside the photograph, which is {width_px} x {height_px} pixels when upright.",
            code="hint_outside",
            hints=outside,
        )


def _bounds(hint: HintDetails) -> Iterator[tuple[float, float, float, float]]:
    """Yield the left, top, right and bottom of the hint's place, px; nothing if it has no place."""
    if "point" in hint:
        x, y = hint["point"]
        yield x, y, x, y
    elif "box" in hint:
        x, y, width, height = hint["box"]
        yield x, y, x + width, y + height
    elif "polygon" in hint:
        corners = [corner for ring in rings_of(hint["polygon"]) for corner in ring]
        xs, ys = zip(*corners, strict=True)
        yield min(xs), min(ys), max(xs), max(ys)
