"""Helpers of a meal's page: outlines, names of the steps' pictures, headline components."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from app.foods.schemas import NutrientAmount, NutrientTotal
from app.nutrition.components import HEADLINES

Nutrient = TypeVar("Nutrient", NutrientAmount, NutrientTotal)
Rings = Sequence[Sequence[tuple[float, float]]]

# picture of a step -> (title, what it shows)
FIGURES: Mapping[str, tuple[str, str]] = {
    "overlay.jpg": (
        "Outlines",
        "The left photograph with the outline and the volume of each food.",
    ),
    "matches.jpg": (
        "Matches",
        "Both photographs side by side; lines join matching points, bold lines those of the fundamental matrix.",
    ),
    "rectified_by_f.jpg": (
        "Rectified by the fundamental matrix",
        "The paper's rectification: matching points lie on the same green row of both pictures.",
    ),
    "rectified.jpg": (
        "Rectified by the poses",
        "The pair from which depth is measured: matching points lie on the same green row of both pictures.",
    ),
    "disparity.jpg": (
        "Disparity",
        "The left rectified picture and each pixel's disparity: blue is far, red is near, black is not matched.",
    ),
    "points.jpg": (
        "Points",
        "The foods' points from the side: measured points in colour, the completed hidden side in grey.",
    ),
    "slices.jpg": (
        "Slices",
        "The foods from above, a circle or ellipse for each slice, coloured by its height.",
    ),
    "topview.jpg": ("From above", "The scene as seen straight from above, in the table's plane."),
}


def outline_path(rings: Rings) -> str:
    """Return rings as an SVG path; holes by the even-odd rule."""
    return " ".join(
        "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in ring) + " Z"
        for ring in rings
        if len(ring) > 0
    )


def label_place(rings: Rings) -> tuple[float, float] | None:
    """Return the position of an item's number: the mean of its outer ring's corners; None without an outline."""
    if not rings or not rings[0]:
        return None
    xs, ys = [x for x, _ in rings[0]], [y for _, y in rings[0]]
    return sum(xs) / len(xs), sum(ys) / len(ys)


def headline(nutrients: Iterable[Nutrient]) -> list[Nutrient]:
    """Return the headline components, energy first."""
    by_number = {nutrient.number: nutrient for nutrient in nutrients}
    headlines = [headline.best_of(by_number) for headline in HEADLINES]
    return [nutrient for nutrient in headlines if nutrient is not None]


def as_runs(digest: str) -> list[str]:
    """Split a checksum into groups of eight characters, which are easier to compare."""
    return [digest[start : start + 8] for start in range(0, len(digest), 8)]
