"""What a phone's hints can be: foods that a table in force has, places within the photograph.

A hint that cannot be is refused while the app can still mend it. One that is merely wrong is kept, and its item flagged
(`hint_missed`), as is one whose photograph comes after it.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.meals.models import MealImage
from app.meals.outline_json import rings_of
from app.meals.receive_photo import SealablePhoto

Hints = Sequence[Mapping[str, Any]]


def require_known_foods(session: Session, hints: Hints) -> None:
    """Raises InvalidInputError `food_unknown` if a hint names a food that no table in force has."""
    keys = {hint["food"] for hint in hints if hint.get("food")}
    unknown = sorted(keys - set(foods.foods_by_key(session, keys))) if keys else []
    if unknown:
        raise InvalidInputError(
            f"No food table in force has {', '.join(unknown)}: GET /v1/foods finds the foods that there are.",
            code="food_unknown",
            foods=unknown,
        )


def require_within(hints: Hints, photo: SealablePhoto | MealImage | None) -> None:
    """Raises InvalidInputError `hint_outside` if a hint lies outside its photograph. photo: None, not here yet."""
    if photo is None:
        return
    width, height = photo.width_px, photo.height_px
    outside = [
        number
        for number, hint in enumerate(hints)
        for left, top, right, bottom in _places(hint)
        if left > width or top > height or right < 0 or bottom < 0
    ]
    if outside:
        raise InvalidInputError(
            f"Hint {outside[0]} lies outside the photograph, which is {width} x {height} pixels when upright.",
            code="hint_outside",
            hints=outside,
        )


def _places(hint: Mapping[str, Any]) -> Iterator[tuple[float, float, float, float]]:
    """Left, top, right and bottom of what the hint points at, px; nothing where it has no place."""
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
