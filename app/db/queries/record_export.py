"""SQL of exported records: columns of plain values, as JSON has them, that no layer above need convert one by one.

Read are a record, its meal and its day; the few studies, participants and foods that these name are looked up once.
Ids and instants come as text from the database, which makes it many times as fast as Python does.
"""

import json
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping
from datetime import date, datetime
from typing import Any, Generic, NamedTuple, TypeVar

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.functions import FunctionElement

from app.db.models import DiaryDay, EffectiveRecord, Food, FoodRelease, Meal, Participant, Study
from app.db.queries import diary
from app.db.queries.record_pages import AFTER_INSTANT, AFTER_ITEM, BEFORE_ALL, RecordSearch
from app.exports.record_columns import RECORD_COLUMNS, Batch

ROWS_A_BATCH = 2000
MOST_KNOWN = 20_000  # participants, foods ... that are kept in memory during an export
STORED = tuple(  # columns that are given as they are stored
    column.name
    for column in RECORD_COLUMNS
    if column.name in EffectiveRecord.__table__.columns and column.name not in {"captured_at", "local_date", "meal_id"}
)
Known = TypeVar("Known")


class text_of(FunctionElement[str]):  # noqa: N801  # named as the SQL function that it stands for
    """A column's value as text: an id with its hyphens, a day, an instant in UTC: "2026-11-21 12:30:00.000000"."""

    type = sa.String()
    inherit_cache = True


@compiles(text_of, "postgresql")
def _text_postgresql(element: Any, compiler: Any, **options: Any) -> str:
    (column,) = element.clauses
    value: str = compiler.process(column, **options)
    if isinstance(column.type, sa.Uuid):
        return f"CAST({value} AS TEXT)"
    if isinstance(column.type, sa.Date):
        return f"to_char({value}, 'YYYY-MM-DD')"
    return f"to_char({value} AT TIME ZONE 'UTC', 'YYYY-MM-DD HH24:MI:SS.US')"


@compiles(text_of, "sqlite")
def _text_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    (column,) = element.clauses
    value: str = compiler.process(column, **options)
    if not isinstance(column.type, sa.Uuid):
        return value
    parts = (f"substr({value}, {start}, {length})" for start, length in ((1, 8), (9, 4), (13, 4), (17, 4), (21, 12)))
    return "(" + " || '-' || ".join(parts) + ")"


class _Person(NamedTuple):
    code: str
    first_day: int | None  # ordinal of day 1


class _Food(NamedTuple):
    key: str | None
    name: str | None
    table: str | None


class _Lookup(Generic[Known]):
    """What ids stand for, learnt a batch at a time, and forgotten before it is too much."""

    def __init__(self, find: Callable[[Collection[Any]], Mapping[Any, Known]]) -> None:
        self._find, self._known = find, dict[Any, Known]()

    def __call__(self, ids: Collection[Any]) -> list[Known]:
        new = set(ids) - self._known.keys()
        if len(self._known) + len(new) > MOST_KNOWN:
            self._known.clear()
            new = set(ids)
        if new:
            self._known.update(self._find(new))
        known = self._known
        return [known[one] for one in ids]


def export_batches(session: Session, search: RecordSearch | None) -> Iterator[Batch]:
    """All records of a search in the order of (captured_at, item id), a batch of columns (RECORD_COLUMNS) at a time.

    In one transaction of the caller's, so that they are of one moment.
    """
    if search is None:
        return
    study_codes = _Lookup(lambda ids: _studies(session, ids))
    people = _Lookup(lambda ids: _people(session, ids))
    foods = _Lookup(lambda ids: _foods(session, ids))
    query, after = _rows(search), BEFORE_ALL
    while True:
        found = session.connection().execute(query, {AFTER_INSTANT: after[0], AFTER_ITEM: after[1]})
        rows = list(found.cursor.fetchall())  # the driver's own: its values need no conversion
        found.close()
        if not rows:
            return
        rows.sort()  # by instant and id, as texts in the same order; few moves, since the page is read in its order
        columns = dict(zip(READ, map(list, zip(*rows, strict=True)), strict=True))
        after = (datetime.fromisoformat(columns["captured_at"][-1] + "+00:00"), uuid.UUID(columns["id"][-1]))
        columns["study"] = study_codes(columns["study_id"])
        persons, eaten = people(columns["participant_id"]), foods(columns["food_id"])
        columns["participant"] = [person.code for person in persons]
        columns["food_key"] = [food.key for food in eaten]
        columns["food_name"] = [food.name for food in eaten]
        columns["food_table"] = [food.table for food in eaten]
        columns["study_day"] = [
            None if person.first_day is None else date.fromisoformat(day).toordinal() - person.first_day + 1
            for person, day in zip(persons, columns["local_date"], strict=True)
        ]
        columns["upload_delay_seconds"] = [
            (datetime.fromisoformat(received) - datetime.fromisoformat(captured)).total_seconds()
            for received, captured in zip(columns["received_at"], columns["captured_at"], strict=True)
        ]
        columns["captured_at"] = [
            f"{text[:10]}T{text[11:19]}Z" if text.endswith(".000000") else f"{text[:10]}T{text[11:]}Z"
            for text in columns["captured_at"]
        ]
        columns["flags"] = [[] if text == "[]" else json.loads(text) for text in columns["flags"]]
        for name in ("provisional", "reviewed"):  # SQLite's are numbers
            columns[name] = [value == 1 for value in columns[name]]
        yield [columns[column.name] for column in RECORD_COLUMNS]
        if len(rows) < ROWS_A_BATCH:
            return


RECORD_READ = ("captured_at", "item_id", "meal_id", "local_date", "study_id", "participant_id", "food_id", *STORED)
READ = (
    *("captured_at", "id", "meal_id", "time_zone", "received_at", "local_date", "day_status"),
    *("study_id", "participant_id", "food_id"),
    *STORED,
)


def _rows(search: RecordSearch) -> sa.Select[*tuple[Any, ...]]:
    """A batch: the columns READ. The statement is made once: it takes longer than to read some hundred rows."""
    page = search.pages(ROWS_A_BATCH, *(getattr(EffectiveRecord, name) for name in RECORD_READ[2:]))
    plain: dict[str, Any] = {
        "provisional": sa.cast(page.c.provisional, sa.Integer),
        "reviewed": sa.cast(page.c.reviewed, sa.Integer),
        "flags": sa.cast(page.c.flags, sa.Text),
    }
    of_day = sa.and_(DiaryDay.participant_id == page.c.participant_id, DiaryDay.local_date == page.c.local_date)
    return sa.select(
        text_of(page.c.captured_at),
        text_of(page.c.item_id),
        text_of(Meal.client_id),
        Meal.time_zone,
        text_of(Meal.received_at),
        text_of(page.c.local_date),
        sa.func.coalesce(DiaryDay.status, "open"),
        sa.cast(page.c.study_id, sa.Text),
        sa.cast(page.c.participant_id, sa.Text),
        page.c.food_id,
        *(plain.get(name, page.c[name]) for name in STORED),
    ).select_from(page.join(Meal, Meal.id == page.c.meal_id).outerjoin(DiaryDay, of_day))


def _studies(session: Session, ids: Collection[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    query = sa.select(Study.id, Study.code).where(Study.id.in_([uuid.UUID(one) for one in ids]))
    for study_id, code in session.execute(query):
        found |= dict.fromkeys(_spellings(study_id), code)
    return found


def _people(session: Session, ids: Collection[str]) -> dict[str, _Person]:
    every = [uuid.UUID(one) for one in ids]
    first = diary.first_days(session, every)
    found: dict[str, _Person] = {}
    for participant_id, code in session.execute(
        sa.select(Participant.id, Participant.code).where(Participant.id.in_(every))
    ):
        day = first.get(participant_id)
        found |= dict.fromkeys(_spellings(participant_id), _Person(code, None if day is None else day.toordinal()))
    return found


def _foods(session: Session, ids: Collection[int | None]) -> dict[int | None, _Food]:
    query = (
        sa.select(Food.id, Food.key, Food.name, FoodRelease.name + " " + FoodRelease.version)
        .join(FoodRelease, FoodRelease.id == Food.release_id)
        .where(Food.id.in_([one for one in ids if one is not None]))
    )
    found: dict[int | None, _Food] = {None: _Food(None, None, None)}
    return found | {food_id: _Food(key, name, table) for food_id, key, name, table in session.execute(query)}


def _spellings(one: uuid.UUID) -> tuple[str, str]:
    """An id as PostgreSQL's text of it, and as SQLite keeps it."""
    return str(one), one.hex
