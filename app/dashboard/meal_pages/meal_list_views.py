"""A meal of a list as the gallery and the table show it."""

import uuid
from dataclasses import dataclass
from datetime import UTC
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from app.exports.lists.list_meals import MealSums, sums_of
from app.exports.lists.meal_row_queries import MealRow
from app.meals.item_state import REMEASURING
from app.meals.queries import UNESTIMATED

# why a meal failed: the codes of docs/errors.md, "Meals that cannot be measured"
FAILURES = (
    *("image_too_small", "image_too_dark", "image_blurred"),
    *("marker_not_found", "marker_covered", "marker_mismatch"),
    *("camera_mismatch", "same_photograph"),
    *("baseline_too_small", "baseline_too_large", "focal_unknown", "pose_unreliable", "too_few_matches", "scene_moved"),
    *("table_not_found", "rig_mismatch"),
    *("food_not_measured", "no_food_found"),
    *("photo_damaged", "estimate_crashed", "estimate_timed_out", "estimate_killed"),
    *("estimate_out_of_memory", "cancelled", "job_gave_up"),
)
FOODS_NAMED = 6  # in a picture's words


@dataclass(frozen=True, slots=True)
class ListedMeal:
    """A row and what its records come to."""

    row: MealRow
    sums: MealSums

    @property
    def key(self) -> tuple[str, uuid.UUID]:
        """What it is known by in its study."""
        return self.row.participant_code, self.row.meal.client_id

    @property
    def element(self) -> str:
        """Its place on the page."""
        return element_of(*self.key)

    @property
    def watched(self) -> str:
        """As it is shown: asked for by it, it is told only if it has become another."""
        return f"{self.row.participant_code}:{self.row.meal.client_id}:{self.row.meal.version}"

    @property
    def is_moving(self) -> bool:
        """Whether it waits for a worker or for the rest of its photographs, or its after-meal pair or an item does."""
        meal = self.row.meal
        return (
            meal.status in UNESTIMATED
            or meal.after_status in UNESTIMATED
            or any(REMEASURING in record.flags for record in self.row.records)
        )

    @property
    def delay_seconds(self) -> float:
        """From eating to the first of it on the server."""
        return (self.row.meal.received_at - self.row.meal.captured_at).total_seconds()

    @property
    def foods(self) -> str:
        """What it is, in words; "" where nothing is known of it."""
        names = [food.name for food in self.sums.foods]
        unknown = sum(record.food_key is None for record in self.row.records)
        if unknown:
            names.append("a food that is not known" if unknown == 1 else f"{unknown} foods that are not known")
        if names:
            more = len(names) - FOODS_NAMED
            return "; ".join(names[:FOODS_NAMED]) + (f"; {more} more" if more > 0 else "")
        return "nothing" if self.row.meal.status == "confirmed" else ""

    @property
    def words(self) -> str:
        """What is known of its photograph, for who does not see it."""
        return f"Meal of {self.row.participant_code}, {self.when}: {self.foods or 'its foods are not known'}"

    @property
    def when(self) -> str:
        """When it was eaten, in its own time zone."""
        meal = self.row.meal
        try:
            zone = ZoneInfo(meal.time_zone)
        except (ZoneInfoNotFoundError, ValueError):
            return f"{meal.captured_at.astimezone(UTC):%Y-%m-%d %H:%M}"
        return f"{meal.captured_at.astimezone(zone):%Y-%m-%d %H:%M}"


def element_of(participant: str, client_id: uuid.UUID) -> str:
    """The id of a meal's place on the page."""
    return f"meal-{participant}-{client_id}"


def listed(row: MealRow) -> ListedMeal:
    """The row with its sums."""
    return ListedMeal(row, sums_of(row))
