"""SQL of exported records: rows of plain values, as JSON has them, that no layer above need convert one by one.

Ids, instants and days come as text from the database, which makes it many times as fast as Python does.
"""

import json
import uuid
from collections.abc import Iterator, MutableMapping
from datetime import date, datetime
from functools import lru_cache
from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.functions import FunctionElement

from app.db.models import DiaryDay, EffectiveRecord, Food, FoodRelease, Meal, Participant, Study
from app.db.queries import diary
from app.db.queries.record_pages import Key, RecordSearch
from app.exports.record_columns import RECORD_NAMES, Batch

ROWS_A_BATCH = 2000
MOST_PARTICIPANTS_KNOWN = 20_000  # whose day 1 is kept in memory during an export


class text_of(FunctionElement[str]):  # noqa: N801  # named as the SQL function that it stands for
    """A column's value as JSON has it: an id with its hyphens, an instant in UTC with microseconds, a day."""

    type = sa.String()
    inherit_cache = True


@compiles(text_of, "postgresql")
def _text_postgresql(element: Any, compiler: Any, **options: Any) -> str:
    (column,) = element.clauses
    value = compiler.process(column, **options)
    if isinstance(column.type, sa.Uuid):
        return f"CAST({value} AS TEXT)"
    if isinstance(column.type, sa.Date):
        return f"to_char({value}, 'YYYY-MM-DD')"
    return f"""to_char({value} AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS.US"Z"')"""


@compiles(text_of, "sqlite")
def _text_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    (column,) = element.clauses
    value: str = compiler.process(column, **options)
    if isinstance(column.type, sa.Uuid):
        parts = (
            f"substr({value}, {start}, {length})" for start, length in ((1, 8), (9, 4), (13, 4), (17, 4), (21, 12))
        )
        return "(" + " || '-' || ".join(parts) + ")"
    if isinstance(column.type, sa.Date):
        return value
    return f"(substr({value}, 1, 10) || 'T' || substr({value}, 12) || 'Z')"


class exact_seconds_between(FunctionElement[float]):  # noqa: N801  # the same
    """Seconds from the first instant to the second, to the microsecond, rounded as Python's total_seconds()."""

    type = sa.Float()
    inherit_cache = True


@compiles(exact_seconds_between, "postgresql")
def _exact_postgresql(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"CAST(EXTRACT(EPOCH FROM ({second} - {first})) AS DOUBLE PRECISION)"


@compiles(exact_seconds_between, "sqlite")
def _exact_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    seconds = f"(strftime('%s', substr({second}, 1, 19)) - strftime('%s', substr({first}, 1, 19)))"
    microseconds = f"(CAST(substr({second}, 21) AS INTEGER) - CAST(substr({first}, 21) AS INTEGER))"
    return f"(({seconds} * 1000000 + {microseconds}) / 1000000.0)"


def export_batches(session: Session, search: RecordSearch | None) -> Iterator[Batch]:
    """All records of a search in the order of (captured_at, item id), a batch of columns (RECORD_COLUMNS) at a time.

    In one transaction of the caller's, so that they are of one moment.
    """
    after, first_days = None, dict[str, date | None]()
    while search is not None:
        rows = session.execute(_rows(search, after)).all()
        if not rows:
            return
        columns: Batch = [list(values) for values in zip(*rows, strict=True)]
        after = (datetime.fromisoformat(columns[CAPTURED_AT][-1]), uuid.UUID(columns[ID][-1]))
        participants = columns.pop()
        for place in BOOLEANS:  # SQLite's are numbers
            columns[place] = [value == 1 for value in columns[place]]
        columns[CAPTURED_AT] = [text.replace(".000000Z", "Z") for text in columns[CAPTURED_AT]]
        columns[FLAGS] = [_flags(text) for text in columns[FLAGS]]
        _learn_first_days(session, first_days, set(participants))
        columns.append(
            [
                None
                if (first := first_days[one]) is None
                else date.fromisoformat(day).toordinal() - first.toordinal() + 1
                for one, day in zip(participants, columns[LOCAL_DATE], strict=True)
            ]
        )
        yield columns
        if len(rows) < ROWS_A_BATCH:
            return


ID, CAPTURED_AT, LOCAL_DATE, FLAGS = (RECORD_NAMES.index(name) for name in ("id", "captured_at", "local_date", "flags"))
BOOLEANS = tuple(RECORD_NAMES.index(name) for name in ("provisional", "reviewed"))


def _rows(search: RecordSearch, after: Key | None) -> sa.Select[*tuple[Any, ...]]:
    """A batch's columns but study_day, and the participant's id behind them."""
    record = EffectiveRecord
    page = search.keys(after, ROWS_A_BATCH)
    computed: dict[str, Any] = {
        "id": text_of(record.item_id),
        "meal_id": text_of(Meal.client_id),
        "study": Study.code,
        "participant": Participant.code,
        "captured_at": text_of(record.captured_at),
        "time_zone": Meal.time_zone,
        "local_date": text_of(record.local_date),
        "upload_delay_seconds": exact_seconds_between(record.captured_at, Meal.received_at),
        "provisional": sa.cast(record.provisional, sa.Integer),
        "reviewed": sa.cast(record.reviewed, sa.Integer),
        "food_key": Food.key,
        "food_name": Food.name,
        "food_table": FoodRelease.name + " " + FoodRelease.version,
        "flags": sa.cast(record.flags, sa.Text),
        "day_status": sa.func.coalesce(DiaryDay.status, "open"),
    }
    columns = [computed[name] if name in computed else getattr(record, name) for name in RECORD_NAMES[:-1]]
    of_day = sa.and_(DiaryDay.participant_id == record.participant_id, DiaryDay.local_date == record.local_date)
    return (
        sa.select(*columns, text_of(record.participant_id))
        .select_from(page.join(record, record.item_id == page.c.item_id))
        .join(Meal, Meal.id == record.meal_id)
        .join(Study, Study.id == record.study_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(DiaryDay, of_day)
        .outerjoin(Food, Food.id == record.food_id)
        .outerjoin(FoodRelease, FoodRelease.id == Food.release_id)
        .order_by(page.c.captured_at, page.c.item_id)
    )


def _learn_first_days(session: Session, known: MutableMapping[str, date | None], participants: set[str]) -> None:
    """Day 1 of those that are not known yet; what is known is forgotten before it is too much."""
    new = participants - known.keys()
    if len(known) + len(new) > MOST_PARTICIPANTS_KNOWN:
        known.clear()
        new = participants
    ids = {uuid.UUID(text): text for text in new}
    found = diary.first_days(session, ids.keys())
    known.update({text: found.get(one) for one, text in ids.items()})


@lru_cache(maxsize=1024)  # of flags there are few combinations
def _parsed(text: str) -> tuple[str, ...]:
    return tuple(json.loads(text))


def _flags(text: str) -> list[str]:
    return [] if text == "[]" else list(_parsed(text))
