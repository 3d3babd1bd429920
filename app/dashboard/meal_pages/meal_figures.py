"""Small things that the page of a meal draws and names: outlines, pictures of steps, the components at the head."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from app.foods.schemas import NutrientAmount, NutrientTotal
from app.nutrition.components import HEADLINE_NUMBERS

Nutrient = TypeVar("Nutrient", NutrientAmount, NutrientTotal)
Rings = Sequence[Sequence[tuple[float, float]]]

# a step's picture -> its name, and what is to be seen on it
FIGURES: Mapping[str, tuple[str, str]] = {
    "overlay.jpg": ("Outlines", "The left photograph with the outline and the volume of each food."),
    "matches.jpg": (
        "Matches",
        "Both photographs side by side; lines join what is the same in either, bold ones made the fundamental matrix.",
    ),
    "rectified_by_f.jpg": (
        "Rectified by the fundamental matrix",
        "The paper's rectification: matching points lie on the same green row of both pictures.",
    ),
    "rectified.jpg": (
        "Rectified by the poses",
        "The pair that depth is measured on: matching points lie on the same green row of both pictures.",
    ),
    "disparity.jpg": (
        "Disparity",
        "The left rectified picture, beside it each pixel's disparity: blue is far, red near, black not matched.",
    ),
    "points.jpg": (
        "Points",
        "The foods' points from the side: measured ones in their colours, the completed hidden side in grey.",
    ),
    "slices.jpg": (
        "Slices",
        "The foods from above, a circle or ellipse for each slice, coloured by its height.",
    ),
    "topview.jpg": ("From above", "The scene as seen straight from above, in the table's plane."),
}


def outline_path(rings: Rings) -> str:
    """Rings as an SVG path; holes by the even-odd rule."""
    return " ".join("M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in ring) + " Z" for ring in rings if len(ring) > 0)


def label_place(rings: Rings) -> tuple[float, float] | None:
    """Where an item's number stands: the middle of its outer ring; None without an outline."""
    if not rings or not rings[0]:
        return None
    xs, ys = [x for x, _ in rings[0]], [y for _, y in rings[0]]
    return sum(xs) / len(xs), sum(ys) / len(ys)


def headline(nutrients: Iterable[Nutrient]) -> list[Nutrient]:
    """Those of a record's own columns, in their order: energy first."""
    known = {nutrient.number: nutrient for nutrient in nutrients}
    found = (next((known[number] for number in numbers if number in known), None) for numbers in HEADLINE_NUMBERS)
    return [nutrient for nutrient in found if nutrient is not None]


def as_runs(digest: str) -> list[str]:
    """A checksum in groups of eight, so that two can be compared by eye."""
    return [digest[start : start + 8] for start in range(0, len(digest), 8)]
