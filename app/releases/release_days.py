"""The figures of frozen days: exact sums, and a day's row after one of its meals was erased.

A database adds in an order of its own, and every order rounds differently: PostgreSQL's last digits change after rows
have moved, and differ from SQLite's. So each sum of a release is rounded once (math.fsum), and median delays are
computed from its meals: the same data give the same bytes, wherever and whenever they are frozen.

A day's row follows from the old row and the remaining rows of meals and items alone; current tables are not read. The
day's number in the study is kept. If a day's only meal was erased, what was eaten is unknown: the sums are unknown,
never 0. A day without a decision about it is removed with its only meal, as in GET /v1/days.
"""

import statistics
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from app.diary.day_definition import SEEN
from app.exports.tables.export_components import Eaten, sums
from app.meals.record_models import HEADLINE_COLUMNS

NamedRow = Mapping[str, Any]  # a row of a file: column -> value of the column's type
EATEN = ("consumed_g", *HEADLINE_COLUMNS)  # of a record, as eaten_on_days has them
NOT_DERIVABLE = ("energy_to_basal_rate", "plausibility")  # would follow from the profile, not from the day's rows


def day_without(
    day: NamedRow,
    left: Sequence[NamedRow],
    gone: Sequence[NamedRow],
    items: Sequence[NamedRow],
    *,
    expects_after_pair: bool,
) -> NamedRow | None:
    """Return the day's row after an erasure; None if the day no longer exists.

    left, gone: rows of the day's remaining and erased meals. items: rows of the remaining meals' items.
    """
    if not left and day["decided_by"] is None:
        return None
    counted = [item for item in items if item["status"] != "rejected"]
    meals_with_items = {item["meal_id"] for item in counted}
    unmeasured = [meal for meal in left if meal["status"] != "confirmed" and meal["meal_id"] not in meals_with_items]
    photographed = {meal["meal_id"] for meal in left if meal["origin"] == "photographed"}
    counts = {
        "meals": len(left),
        "meals_after_closing": _meals_after_closing(day, left, gone),
        "median_upload_delay_seconds": median_delay([meal["upload_delay_seconds"] for meal in left]),
        "items": len(counted),
        "unmeasured_meals": len(unmeasured),
        "unmeasured_items": sum(item["consumed_g"] is None for item in counted),
        "provisional_items": sum(item["provisional"] for item in counted),
        "leftovers_unknown_items": sum(
            expects_after_pair and item["meal_id"] in photographed and _is_leftover_unknown(item) for item in counted
        ),
    }
    is_nothing = bool(left) and day["day_status"] == "closed" and not counted and not unmeasured
    return {**day, **counts, **exact_sums(counted, is_nothing=is_nothing, is_partial=bool(unmeasured))}


def exact_sums(records: Sequence[NamedRow], *, is_nothing: bool, is_partial: bool) -> dict[str, float | None]:
    """Return consumed_g and each headline component's sum and coverage over a day's records that count.

    is_nothing: it is known that nothing was eaten. is_partial: something was eaten that has no record.
    """
    eaten = [Eaten(record["consumed_g"], [record[name] for name in EATEN]) for record in records]
    values = sums(eaten, len(EATEN), is_nothing=is_nothing, is_partial=is_partial)
    exact = dict(zip(EATEN, (value for value, _ in values), strict=True))
    return exact | {f"{name}_coverage": coverage for name, (_, coverage) in zip(EATEN[1:], values[1:], strict=True)}


def median_delay(seconds: Sequence[float]) -> float | None:
    """Return the median; None without meals."""
    return statistics.median(seconds) if seconds else None


def _meals_after_closing(day: NamedRow, left: Sequence[NamedRow], gone: Sequence[NamedRow]) -> int:
    """Count the remaining meals that arrived after the day was closed: they were the last to arrive."""
    latest_first = sorted([*left, *gone], key=lambda meal: datetime.fromisoformat(meal["received_at"]), reverse=True)
    late = {meal["meal_id"] for meal in latest_first[: day["meals_after_closing"]]}
    return sum(meal["meal_id"] in late for meal in left)


def _is_leftover_unknown(item: NamedRow) -> bool:
    return item["origin"] in SEEN and item["consumed_g"] is not None and item["left_g"] is None
