"""The figures of frozen days: exact sums, and of a day without a meal that was erased, from the meals and items left.

A database adds in an order of its own, and every order rounds otherwise: PostgreSQL gives other last digits after rows
have moved, and SQLite other ones than PostgreSQL. So a release has each sum rounded once (math.fsum), and the median of
the delays that its meals have: the same data are the same bytes, wherever and whenever they are frozen.

A day of a release has nothing but what follows from its own row and from these, so that this is exact: no table of now
is asked. The number of the day in the study stays as it was. Where the only meal of a day is gone, nobody knows what
was eaten: the sums are unknown, never 0; a day of which nobody has said a word goes with its meal, as in GET /v1/days.
"""

import statistics
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from app.diary.day_definition import SEEN
from app.exports.tables.export_components import Eaten, sums
from app.meals.record_models import HEADLINE_COLUMNS

NamedRow = Mapping[str, Any]  # a row of a file, by its columns
EATEN = ("consumed_g", *HEADLINE_COLUMNS)  # of a record, as eaten_on_days has them
NOT_DERIVABLE = ("energy_to_basal_rate", "plausibility")  # from a person's profile of then: not in a release


def day_without(
    day: NamedRow,
    left: Sequence[NamedRow],
    gone: Sequence[NamedRow],
    items: Sequence[NamedRow],
    *,
    expects_after_pair: bool,
) -> NamedRow | None:
    """The day's row; None: there is no such day any more.

    left, gone: rows of the day's meals. items: rows of the items of those that are left.
    """
    if not left and day["decided_by"] is None:
        return None
    holding = [item for item in items if item["status"] != "rejected"]
    fed = {item["meal_id"] for item in holding}
    unmeasured = [meal for meal in left if meal["status"] != "confirmed" and meal["meal_id"] not in fed]
    photographed = {meal["meal_id"] for meal in left if meal["origin"] == "photographed"}
    known = {
        "meals": len(left),
        "meals_after_closing": _late(day, left, gone),
        "median_upload_delay_seconds": median_delay([meal["upload_delay_seconds"] for meal in left]),
        "items": len(holding),
        "unmeasured_meals": len(unmeasured),
        "unmeasured_items": sum(item["consumed_g"] is None for item in holding),
        "provisional_items": sum(item["provisional"] for item in holding),
        "leftovers_unknown_items": sum(
            expects_after_pair and item["meal_id"] in photographed and _is_leftover_unknown(item) for item in holding
        ),
    }
    is_nothing = bool(left) and day["day_status"] == "closed" and not holding and not unmeasured
    return {**day, **known, **exact_sums(holding, is_nothing=is_nothing, is_partial=bool(unmeasured))}


def exact_sums(holding: Sequence[NamedRow], *, is_nothing: bool, is_partial: bool) -> dict[str, float | None]:
    """consumed_g, and each headline component's sum and coverage, over a day's records that hold.

    is_nothing: it is known that nothing was eaten. is_partial: something was eaten of which there is no record.
    """
    eaten = [Eaten(item["consumed_g"], [item[name] for name in EATEN]) for item in holding]
    values = sums(eaten, len(EATEN), is_nothing=is_nothing, is_partial=is_partial)
    exact = dict(zip(EATEN, (value for value, _ in values), strict=True))
    return exact | {f"{name}_coverage": coverage for name, (_, coverage) in zip(EATEN[1:], values[1:], strict=True)}


def median_delay(seconds: Sequence[float]) -> float | None:
    """Of the meals of a day; None: there are none."""
    return statistics.median(seconds) if seconds else None


def _late(day: NamedRow, left: Sequence[NamedRow], gone: Sequence[NamedRow]) -> int:
    """Meals that came in after the day was closed: those that came last of all, as many as there were."""
    both = [*left, *gone]
    latest_first = sorted(both, key=lambda meal: datetime.fromisoformat(meal["received_at"]), reverse=True)
    late = {meal["meal_id"] for meal in latest_first[: day["meals_after_closing"]]}
    return sum(meal["meal_id"] in late for meal in left)


def _is_leftover_unknown(item: NamedRow) -> bool:
    return item["origin"] in SEEN and item["consumed_g"] is not None and item["left_g"] is None
