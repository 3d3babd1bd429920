"""SQL of records for FHIR: pages by (captured_at, item id) of records that are not rejected, with their foods.

Pages are read as in records/page_queries.py: by participant, by study and status, or by id, each from an index in the
page's order.
"""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.foods import queries as foods
from app.foods.models import Food
from app.foods.queries import NutrientRow
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord
from app.records.page_queries import (
    MOST_BRANCHES,
    ORDER,
    Branch,
    Key,
    RecordSearch,
    all_studies,
    behind,
    participants_of,
    within_days,
)
from app.records.queries import RecordRow, rows_of_page, rows_of_records

COUNTED = tuple(status for status in RECORD_STATUSES if status != "rejected")


@dataclass(frozen=True, slots=True)
class IntakeFilter:
    """Filters of records; None is no filter. since <= captured_at < before; days are local, both included.

    provisional: whether an after-meal pair may still come.
    """

    study_ids: frozenset[uuid.UUID] | None = None
    participant_ids: frozenset[uuid.UUID] | None = None
    item_ids: frozenset[uuid.UUID] | None = None
    first_day: date | None = None
    last_day: date | None = None
    since: datetime | None = None
    before: datetime | None = None
    provisional: bool | None = None


class IntakeRow(NamedTuple):
    """A record, its food, and all known components of that."""

    row: RecordRow
    food: Food | None
    nutrients: Sequence[NutrientRow]


def page_of_intakes(
    session: Session, chosen: IntakeFilter, *, after: Key | None, limit: int
) -> list[IntakeRow]:
    """Return at most `limit` records after `after`, in the order of (captured_at, item id)."""
    page = _keys(session, chosen, after, limit)
    if page is None:
        return []
    return _with_foods(session, rows_of_page(session, page))


def find_intake(session: Session, item_id: uuid.UUID) -> IntakeRow | None:
    """Return a record, rejected or not."""
    rows = rows_of_records(session, [EffectiveRecord.item_id == item_id], (), 1)
    return next(iter(_with_foods(session, rows)), None)


def participants_by_code(
    session: Session, code: str, studies: Collection[uuid.UUID] | None
) -> list[uuid.UUID]:
    """Return the ids of the participants of this code in these studies (None: in all)."""
    return participants_of(session, code, None, None if studies is None else sorted(studies)) or []


def _keys(session: Session, chosen: IntakeFilter, after: Key | None, limit: int) -> sa.CTE | None:
    """Return the page's captured_at and item_id, unordered; None if the filters exclude everything."""
    record = EffectiveRecord
    conditions = [
        *within_days(chosen.first_day, chosen.last_day),
        *_between(chosen.since, chosen.before),
    ]
    if chosen.provisional is not None:
        conditions.append(record.provisional.is_(chosen.provisional))
    allowed_ids: dict[AnyColumn, Collection[uuid.UUID] | None] = {  # the most selective first
        record.item_id: chosen.item_ids,
        record.participant_id: chosen.participant_ids,
        record.study_id: chosen.study_ids,
    }
    id_filters = [(column, sorted(ids)) for column, ids in allowed_ids.items() if ids is not None]
    if not all(ids for _, ids in id_filters):
        return None
    has_person_or_id = chosen.item_ids is not None or chosen.participant_ids is not None
    if chosen.provisional and not has_person_or_id:
        return _few_keys(session, chosen, conditions, after, limit)
    keys: tuple[AnyColumn, ...] = ()
    branches: list[Branch] = [()]
    if id_filters and (has_person_or_id or len(id_filters[0][1]) <= MOST_BRANCHES):
        (column, ids), *id_filters = id_filters
        keys, branches = (column,), [(id_,) for id_ in ids]
    # the others are compared row by row: nearly all records count, so that costs less than branches
    conditions += [column.in_(ids) for column, ids in id_filters]
    conditions.append(record.status.in_(COUNTED))
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    return RecordSearch(keys, branches, tuple(conditions), is_on_sqlite).page(after, limit)


def _few_keys(
    session: Session,
    chosen: IntakeFilter,
    conditions: Sequence[sa.ColumnElement[bool]],
    after: Key | None,
    limit: int,
) -> sa.CTE:
    """Read all provisional records, which are few, from their own index, and sort them."""
    record = EffectiveRecord
    studies = sorted(chosen.study_ids) if chosen.study_ids is not None else all_studies(session)
    in_studies = [record.study_id.in_(studies)] if len(studies) <= MOST_BRANCHES else []
    # no other conditions here, so that the planner chooses the index of provisional records
    held = (
        sa.select(record.item_id)
        .where(record.provisional.is_(sa.true()), *in_studies)
        .cte("held")
        .prefix_with("MATERIALIZED")
    )
    query = (
        sa.select(record.captured_at, record.item_id)
        .join(held, held.c.item_id == record.item_id)
        .where(record.status.in_(COUNTED), *conditions)
    )
    if after is not None:
        query = query.where(behind(*after))
    return query.order_by(*ORDER).limit(limit).cte("page")


def _between(since: datetime | None, before: datetime | None) -> list[sa.ColumnElement[bool]]:
    captured_at = EffectiveRecord.captured_at
    conditions: list[sa.ColumnElement[bool]] = []
    if since is not None:
        conditions.append(captured_at >= since)
    if before is not None:
        conditions.append(captured_at < before)
    return conditions


def _with_foods(session: Session, rows: Sequence[RecordRow]) -> list[IntakeRow]:
    ids = {row.record.food_id for row in rows if row.record.food_id is not None}
    foods_by_id = {
        food.id: food for food in session.scalars(sa.select(Food).where(Food.id.in_(ids)))
    }
    nutrients = foods.nutrients_of_each(session, ids)
    return [
        IntakeRow(row, foods_by_id[food_id], nutrients[food_id])
        if (food_id := row.record.food_id) is not None
        else IntakeRow(row, None, ())
        for row in rows
    ]
