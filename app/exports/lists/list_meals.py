"""Meals for a page: the caller's filters, keyset pages either way round, an opaque cursor that binds its filters.

And what a gallery asks beside them: how many there are of each status, which of those that it shows have changed, or
are gone.
"""

import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from app.db.session import Database
from app.exports.lists import meal_row_queries as meal_rows
from app.exports.lists.meal_row_queries import MealRow
from app.http.paging import ID, INSTANT, Page, decode_cursor, encode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.people.access.caller import Caller, visible_rows
from app.records.queries import FoodName

Order = Literal["newest", "oldest"]

MOST_COUNTED = 1000  # meals of a status; of more it is said that there are more
MOST_WATCHED = 60  # meals that one call asks about: a page of a gallery


@dataclass(frozen=True, slots=True)
class MealSums:
    """What the records of a meal that hold (not rejected) come to.

    consumed_g, energy_kcal: of those of which it is known; None where there are records and it is known of none, or
    where nothing is known of the meal. unmeasured: records without grams; without_energy: without energy, these
    included; above 0, the sum is incomplete. doubt: the greatest; None without records.
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
    """How many meals have a status; is_more: there are more than these."""

    status: str
    count: int
    is_more: bool


def list_meals(
    database: Database, caller: Caller, chosen: RowFilter, *, order: Order, cursor: str | None, limit: int
) -> Page[MealRow]:
    """One page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = visible_rows(caller, chosen)
    listed = list_name(f"meals {order}", chosen)
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        rows = meal_rows.page_of_meals(session, chosen, after=after, limit=limit + 1, is_newest_first=order == "newest")
    return page_of(listed, rows, limit, lambda row: (row.meal.captured_at, row.meal.id))


def cursor_behind(visible: RowFilter, order: Order, captured_at: datetime, meal_id: uuid.UUID) -> str:
    """Return the cursor of the page behind a place in the list, whether or not a meal is there."""
    return encode_cursor(list_name(f"meals {order}", visible), captured_at, meal_id)


def sums_of(row: MealRow) -> MealSums:
    """A row's records together. Confirmed without foods, nothing was eaten: 0, as `GET /v1/meals/{id}` has it."""
    grams = [record.consumed_g for record in row.records if record.consumed_g is not None]
    energies = [record.energy_kcal for record in row.records if record.energy_kcal is not None]
    is_nothing = not row.records and row.meal.status == "confirmed"
    foods: dict[str, FoodName] = {}  # each once, where it comes first
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


def count_meals(database: Database, study_id: uuid.UUID) -> list[StatusCount]:
    """How many meals of a study have each status, in the order of a meal's way; no more than 1,000 are counted."""
    with database.read() as session:
        counts = meal_rows.count_by_status(session, study_id, MOST_COUNTED + 1)
    return [StatusCount(status, min(count, MOST_COUNTED), count > MOST_COUNTED) for status, count in counts.items()]


def changed_meals(database: Database, study_id: uuid.UUID, known: Sequence[tuple[uuid.UUID, int]]) -> list[MealRow]:
    """Of a study's meals, told by the client's id and the version that is known, those that have another by now.

    One that was erased is not among them.
    """
    with database.read() as session:
        return meal_rows.rows_of(session, meal_rows.changed_meals(session, study_id, known))


def missing_meals(
    database: Database, study_id: uuid.UUID, known: Sequence[tuple[str, uuid.UUID]]
) -> list[tuple[str, uuid.UUID]]:
    """Of these (participant's code, client's id) those that are no meals of the study: erased, or never there."""
    if not known:
        return []
    with database.read() as session:
        there = meal_rows.meals_there(session, study_id, [client_id for _, client_id in known])
    return [key for key in known if key not in there]
