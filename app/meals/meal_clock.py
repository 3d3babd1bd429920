"""Whether the phone's clock may have been wrong when a meal was photographed: its day would be wrong, too."""

from datetime import timedelta

from app.meals.models import Meal

CLOCK_DOUBTFUL = "clock_doubtful"
LONGEST_OFFLINE = timedelta(days=60)  # phones come back from a summer without a network; a clock is off by years
MOST_AHEAD = timedelta(minutes=15)  # of the server's clock, when the meal had come


def time_flags(meal: Meal) -> list[str]:
    """The flag of a meal that came long after its time of capture, or before it. What a person declares has none."""
    delay = meal.received_at - meal.captured_at
    is_odd = meal.origin == "photographed" and not -MOST_AHEAD <= delay <= LONGEST_OFFLINE
    return [CLOCK_DOUBTFUL] if is_odd else []
