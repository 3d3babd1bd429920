"""Pages of meals: the caller's filters, keyset pages in either order, opaque cursors that are bound to their filters.

Also what a gallery needs: counts by status, and which of the meals that it shows have changed or are gone.
"""

import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from app.db.session import Database
from app.exports.lists import meal_row_queries as meal_rows
from app.exports.lists.meal_row_queries import MealRow, PhotographedMeals
from app.http.paging import ID, INSTANT, Page, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.people.access.caller import Caller, visible_rows
from app.records.queries import FoodName
from app.records.review.queries import count_meals_to_look_at

Order = Literal["newest", "oldest"]

MOST_COUNTED = 1000  # meals of a status
MOST_SORTED = 1000  # meals that are sorted by their doubt
MOST_WATCHED = 60  # meals in one request for changes: a page of a gallery


@dataclass(frozen=True, slots=True)
class MealSums:
    """Sums over the records of a meal that count (not rejected).

    consumed_g, energy_kcal: over records with a known value; None if none has one, or if nothing is known of the meal.
    unmeasured: records without grams; without_energy: records without energy, including these; above 0, the sum is
    incomplete. doubt: the greatest; None without records.
    """

    items: int
    foods: tuple[FoodName, ...]
    consumed_g: float | None
    energy_kcal: float | None
    unmeasured: int
    without_energy: int
    provisional: bool
    doubt: float | None
    flags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StatusCount:
    """The number of meals with a status; is_more: there are more."""

    status: str
    count: int
    is_more: bool


def list_meals(
    database: Database,
    caller: Caller,
    chosen: RowFilter,
    *,
    order: Order,
    cursor: str | None,
    limit: int,
) -> Page[MealRow]:
    """Return a page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = visible_rows(caller, chosen)
    listed = list_name(f"meals {order}", chosen)
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        rows = meal_rows.page_of_meals(
            session, chosen, after=after, limit=limit + 1, is_newest_first=order == "newest"
        )
    return page_of(listed, rows, limit, lambda row: (row.meal.captured_at, row.meal.id))


def sums_of(row: MealRow) -> MealSums:
    """Sum a row's records. A confirmed meal without foods sums to 0, as in `GET /v1/meals/{id}`."""
    grams = [record.consumed_g for record in row.records if record.consumed_g is not None]
    energies = [record.energy_kcal for record in row.records if record.energy_kcal is not None]
    is_nothing = not row.records and row.meal.status == "confirmed"
    foods: dict[str, FoodName] = {}  # each once, at its first place
    for record in row.records:
        if record.food_key is not None and record.food_name is not None:
            foods.setdefault(record.food_key, FoodName(record.food_key, record.food_name))
    return MealSums(
        items=len(row.records),
        foods=tuple(foods.values()),
        consumed_g=math.fsum(grams) if grams or is_nothing else None,
        energy_kcal=math.fsum(energies) if energies or is_nothing else None,
        unmeasured=len(row.records) - len(grams),
        without_energy=len(row.records) - len(energies),
        provisional=any(record.provisional for record in row.records),
        doubt=max((record.doubt for record in row.records), default=None),
        flags=tuple(dict.fromkeys(flag for record in row.records for flag in record.flags)),
    )


def list_doubtful_meals(
    database: Database, caller: Caller, chosen: RowFilter, limit: int
) -> list[MealRow]:
    """Return the most doubtful of the newest 1,000 meals of these filters, the most doubtful first."""
    with database.read() as session:
        return meal_rows.most_doubtful(session, visible_rows(caller, chosen), MOST_SORTED, limit)


def count_meals(database: Database, study_id: uuid.UUID) -> tuple[list[StatusCount], int]:
    """Count a study's meals by status, in the order in which a meal goes through them, and those that need a look.

    Up to 1,000 each.
    """
    with database.read() as session:
        counts = meal_rows.count_by_status(session, study_id, MOST_COUNTED + 1)
        to_look_at = count_meals_to_look_at(session, study_id)
    by_status = [
        StatusCount(status, min(count, MOST_COUNTED), count > MOST_COUNTED)
        for status, count in counts.items()
    ]
    return by_status, to_look_at


def count_photographed(database: Database, study_id: uuid.UUID) -> PhotographedMeals:
    """Count a study's photographed meals."""
    with database.read() as session:
        return meal_rows.count_photographed(session, study_id)


def changed_meals(
    database: Database, study_id: uuid.UUID, versions: Sequence[tuple[uuid.UUID, int]]
) -> list[MealRow]:
    """Return the meals whose version differs from these (client id, version), without erased ones."""
    with database.read() as session:
        return meal_rows.rows_of(session, meal_rows.changed_meals(session, study_id, versions))


def missing_meals(
    database: Database, study_id: uuid.UUID, keys: Sequence[tuple[str, uuid.UUID]]
) -> list[tuple[str, uuid.UUID]]:
    """Return those of these (participant's code, client id) that are no meals of the study."""
    if not keys:
        return []
    with database.read() as session:
        existing = meal_rows.existing_meals(session, study_id, [client_id for _, client_id in keys])
    return [key for key in keys if key not in existing]
