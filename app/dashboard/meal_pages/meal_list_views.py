"""A meal in the gallery and in the table of meals."""

import uuid
from dataclasses import dataclass
from datetime import UTC
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from app.exports.lists.list_meals import MealSums, sums_of
from app.exports.lists.meal_row_queries import MealRow
from app.meals.stored.item_state import REMEASURING
from app.meals.stored.queries import UNESTIMATED

# why a meal failed: the codes of docs/errors.md, "Meals that cannot be measured"
FAILURES = (
    *("image_too_small", "image_too_dark", "image_blurred"),
    *("marker_not_found", "marker_covered", "marker_mismatch"),
    *("camera_mismatch", "same_photograph"),
    *(
        "baseline_too_small",
        "baseline_too_large",
        "focal_unknown",
        "pose_unreliable",
        "too_few_matches",
        "scene_moved",
    ),
    *("table_not_found", "rig_mismatch", "depth_unreadable", "depth_mismatch", "depth_empty"),
    *("draw_unusable", "food_not_measured", "no_food_found"),
    *("photo_damaged", "photograph_missing"),
    *("estimate_crashed", "estimate_timed_out", "estimate_killed"),
    *("estimate_out_of_memory", "cancelled", "job_gave_up"),
)
FOODS_NAMED = 6  # in a photograph's description


@dataclass(frozen=True, slots=True)
class ListedMeal:
    """A meal and the sums of its records."""

    row: MealRow
    sums: MealSums

    @property
    def key(self) -> tuple[str, uuid.UUID]:
        """The meal's key in its study."""
        return self.row.participant_code, self.row.meal.client_id

    @property
    def element(self) -> str:
        """The id of its HTML element."""
        return element_of(*self.key)

    @property
    def watched(self) -> str:
        """Key and shown version, by which the page polls for a newer version."""
        return f"{self.row.participant_code}:{self.row.meal.client_id}:{self.row.meal.version}"

    @property
    def is_moving(self) -> bool:
        """Whether the meal, its after-meal pair or an item waits for a worker or for photographs."""
        meal = self.row.meal
        return (
            meal.status in UNESTIMATED
            or meal.after_status in UNESTIMATED
            or any(REMEASURING in record.flags for record in self.row.records)
        )

    @property
    def delay_seconds(self) -> float:
        """Time from eating to the arrival of the first part."""
        return (self.row.meal.received_at - self.row.meal.captured_at).total_seconds()

    @property
    def foods(self) -> str:
        """Names of the foods; "" if nothing is known."""
        names = [food.name for food in self.sums.foods]
        unknown = sum(record.food_key is None for record in self.row.records)
        if unknown:
            names.append("an unknown food" if unknown == 1 else f"{unknown} unknown foods")
        if names:
            more = len(names) - FOODS_NAMED
            return "; ".join(names[:FOODS_NAMED]) + (f"; {more} more" if more > 0 else "")
        return "nothing" if self.row.meal.status == "confirmed" else ""

    @property
    def description(self) -> str:
        """The photograph's alternative text."""
        return f"Meal of {self.row.participant_code}, {self.when}: {self.foods or 'its foods are unknown'}"

    @property
    def when(self) -> str:
        """When the meal was eaten, in its time zone."""
        meal = self.row.meal
        try:
            zone = ZoneInfo(meal.time_zone)
        except (ZoneInfoNotFoundError, ValueError):
            return f"{meal.captured_at.astimezone(UTC):%Y-%m-%d %H:%M}"
        return f"{meal.captured_at.astimezone(zone):%Y-%m-%d %H:%M}"


def element_of(participant: str, client_id: uuid.UUID) -> str:
    """Return the id of a meal's HTML element."""
    return f"meal-{participant}-{client_id}"


def listed_meal(row: MealRow) -> ListedMeal:
    """Return the row with its sums."""
    return ListedMeal(row, sums_of(row))
