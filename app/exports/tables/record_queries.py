"""SQL of exported records: rows of plain values, as JSON has them, that no layer above need convert one by one.

A row holds what an item has of its own, and the ids of its meal and food; what these name (a meal with its
participant, study and day; a food with its table) is looked up a batch at a time, once for all rows that share it.
Values come as the driver gives them, PostgreSQL's in its binary form; ids come as text, which is many times as fast as
making objects.
"""

import json
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from datetime import date, datetime
from itertools import islice
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

import sqlalchemy as sa
from psycopg import Cursor, pq
from sqlalchemy.dialects import postgresql
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, AnyQuery
from app.db.stored_ids import stored_id
from app.foods.models import Food, FoodRelease
from app.http.tables.columns import Batch, ConvertedOnce, Part, PartOfBatch, Row, distinct, instant_text, local_text
from app.http.tables.geojson_rows import POINT
from app.http.tables.record_columns import (
    AMOUNTS,
    CHANGE,
    CONSUMED_G,
    DENSITY_SOURCE,
    DOUBT,
    FLAGS,
    FOOD_VERSION,
    OF_DAY,
    OF_FOOD,
    OF_MEAL,
    RECORD_ID,
    RECORD_PARTS,
    STATE,
    VOLUME,
)
from app.meals.day_models import DiaryDay
from app.meals.models import Meal
from app.meals.queries import first_days
from app.meals.record_models import EffectiveRecord
from app.people.models import Participant, Study
from app.records.page_queries import AFTER_INSTANT, AFTER_ITEM, BEFORE_ALL, RecordSearch

ROWS_A_BATCH = 4096  # a Parquet row group is eight of them
MOST_KNOWN = 20_000  # participants, foods ... that are kept in memory during an export
OWN = (STATE, VOLUME, DENSITY_SOURCE, AMOUNTS, FLAGS, CHANGE, DOUBT)  # parts that are read as they are stored
KEYS = ("captured_at", "item_id", "meal_id", "food_id", "food_version", "run_id")  # what a row begins with
HEX_DIGITS = 32  # of an id without hyphens
IDS = "ids"  # parameter of a look-up
NOWHERE = (None, None)
Rows = Sequence[tuple[Any, ...]]  # as the driver gives them: the columns KEYS and those of OWN
Known = TypeVar("Known")
Id = TypeVar("Id")


class _Person(NamedTuple):
    code: str
    first_day: int | None  # ordinal of day 1


class _Food(NamedTuple):
    of_food: tuple[str | None, ...]  # the values of OF_FOOD
    version: int | None


class Keys(NamedTuple):
    """Columns of a batch's records: ids as the database gives them as text, and what amounts follow from."""

    item_ids: Sequence[str]
    meal_ids: Sequence[str]
    food_ids: Sequence[int | None]
    food_versions: Sequence[int | None]
    run_ids: Sequence[str | None]
    densities_g_per_ml: Sequence[float | None]
    consumed_g: Sequence[float | None]


More = Callable[[Keys], Batch]


class Lookup(Generic[Id, Known]):
    """Values by id: read for a batch of ids at a time, and dropped before they take too much memory."""

    def __init__(self, find: Callable[[Collection[Id]], Mapping[Id, Known]], most_known: int = MOST_KNOWN) -> None:
        self._find, self._most_known, self._known = find, most_known, dict[Id, Known]()

    def __call__(self, ids: Collection[Id]) -> list[Known]:
        """Return each id's value."""
        new = set(ids) - self._known.keys()
        if len(self._known) + len(new) > self._most_known:
            self._known.clear()
            new = set(ids)
        if new:
            self._known.update(self._find(new))
        return list(map(self._known.__getitem__, ids))


def export_batches(
    session: Session, search: RecordSearch | None, parts: Sequence[Part] = RECORD_PARTS, more: More = lambda _: []
) -> Iterator[Batch]:
    """All records of a search in the order of (captured_at, item id), a batch of these parts at a time.

    more: returns those parts of a batch that are not read here. In one transaction of the caller's, so that they are
    of one moment.
    """
    if search is None:
        return
    find_meals = _meal_finder(session, with_point=POINT in parts)
    foods = Lookup(lambda ids: _foods(session, ids))
    for rows in (_one_query if search.is_on_sqlite else _query_by_query)(session.connection(), search):
        own: dict[Part, list[Any]] = {part: list(map(itemgetter(place), rows)) for part, place in PLACES.items()}
        _, item_ids, meal_ids, food_ids, food_versions, run_ids = zip(*map(KEY_VALUES, rows), strict=True)
        densities, consumed_g = list(map(DENSITY, own[VOLUME])), list(map(CONSUMED, own[AMOUNTS]))
        keys = Keys(item_ids, meal_ids, food_ids, food_versions, run_ids, densities, consumed_g)
        batch = {each.part: each for each in (*find_meals(meal_ids), *more(keys))}
        for part, values in own.items():
            batch[part] = PartOfBatch(part, values).deduplicated()
        batch[STATE], batch[FLAGS] = batch[STATE].converted(_state), batch[FLAGS].converted(_flags)
        batch[RECORD_ID] = PartOfBatch(RECORD_ID, hyphenated(item_ids))
        different_ids, places = distinct(food_ids)
        of_foods = foods(different_ids)
        batch[OF_FOOD] = PartOfBatch(OF_FOOD, [food.of_food for food in of_foods], places)
        batch[FOOD_VERSION] = PartOfBatch(FOOD_VERSION, [food.version for food in of_foods], places)
        yield [batch[part] for part in parts]


def _places() -> dict[Part, slice | int]:
    """Where a row has the columns of OWN, behind the KEYS."""
    places: dict[Part, slice | int] = {}
    start = len(KEYS)
    for part in OWN:
        count = len(part.columns)
        places[part] = slice(start, start + count) if count > 1 else start
        start += count
    return places


PLACES = _places()
KEY_VALUES = itemgetter(slice(len(KEYS)))
CONSUMED = itemgetter(AMOUNTS.columns.index(CONSUMED_G))
DENSITY = itemgetter([column.name for column in VOLUME.columns].index("density_g_per_ml"))
COLUMNS = tuple(
    getattr(EffectiveRecord, name) for name in (*KEYS[2:], *(column.name for part in OWN for column in part.columns))
)


def _one_query(connection: sa.Connection, search: RecordSearch) -> Iterator[Rows]:
    """SQLite reads on where it is: one query for all, whose rows come as they are asked for."""
    result = connection.execute(search.rows(*COLUMNS))
    try:
        while rows := result.cursor.fetchmany(ROWS_A_BATCH):  # the driver's own: its values need no conversion
            yield rows
    finally:
        result.close()


def _query_by_query(connection: sa.Connection, search: RecordSearch) -> Iterator[Rows]:
    """PostgreSQL plans each batch as a page, which it reads from indexes: for all rows at once it would sort them.

    The statement is made once: it takes longer than to read some hundred rows.
    """
    sa.event.listen(connection, "before_cursor_execute", _ask_for_binary)
    page = search.pages(ROWS_A_BATCH, *COLUMNS)
    as_text = {"item_id", "meal_id", "run_id", "flags"}
    query = sa.select(*(sa.cast(column, sa.Text) if column.name in as_text else column for column in page.c))
    after = BEFORE_ALL
    while True:
        result = connection.execute(query, {AFTER_INSTANT: after[0], AFTER_ITEM: after[1]})
        rows: Rows = sorted(result.cursor.fetchall())  # by instant and id; few moves, since that is how they were read
        result.close()
        if rows:
            yield rows
        if len(rows) < ROWS_A_BATCH:
            return
        after = (rows[-1][0], uuid.UUID(rows[-1][1]))


def _ask_for_binary(_connection: sa.Connection, cursor: Cursor, *_: object) -> None:
    """Let PostgreSQL send numbers as they are: it need not write them as text, nor we read them."""
    cursor.format = pq.Format.BINARY


def _flags(text: str) -> tuple[str, ...]:
    return tuple(json.loads(text))


def _state(row: Row) -> Row:
    status, origin, provisional, reviewed = row
    return status, origin, bool(provisional), bool(reviewed)  # SQLite's are numbers


def _meal_finder(session: Session, *, with_point: bool) -> Callable[[Sequence[str]], Batch]:
    """Return a function from records' meal ids to OF_MEAL, OF_DAY and, with_point, the POINT where the meal was."""
    connection, is_on_sqlite = session.connection(), session.get_bind().dialect.name == "sqlite"
    study_codes, people = Lookup(lambda ids: _studies(session, ids)), Lookup(lambda ids: _people(session, ids))
    query, days = _meals(is_on_sqlite=is_on_sqlite, with_point=with_point), ConvertedOnce(_day)

    def find(meal_ids: Sequence[str]) -> Batch:
        rows = rows_of_ids(connection, query, set(meal_ids), is_on_sqlite=is_on_sqlite)
        columns = zip(*rows, strict=True)
        ids, client_ids, captured_at, offsets, time_zones = islice(columns, 5)
        dates, received_at, studies, persons, day_statuses, *point = columns
        captured, received = _instants(captured_at), _instants(received_at)
        of_days, of_people = days.of(dates), people(persons)
        of_meal = zip(
            hyphenated(client_ids),
            study_codes(studies),
            [person.code for person in of_people],
            _instant_texts(captured_at),
            map(local_text, captured, offsets),
            time_zones,
            [day for day, _ in of_days],
            [(end - start).total_seconds() for start, end in zip(captured, received, strict=True)],
            strict=True,
        )
        study_days = [
            None if person.first_day is None else ordinal - person.first_day + 1
            for person, (_, ordinal) in zip(of_people, of_days, strict=True)
        ]
        numbers = {meal_id: number for number, meal_id in enumerate(ids)}
        places = list(map(numbers.__getitem__, meal_ids))
        batch = [
            PartOfBatch(OF_MEAL, list(of_meal), places),
            PartOfBatch(OF_DAY, list(zip(day_statuses, study_days, strict=True)), places),
        ]
        return [*batch, PartOfBatch(POINT, list(map(point_of, *point)), places)] if with_point else batch

    return find


def _meals(*, is_on_sqlite: bool, with_point: bool) -> AnyQuery:
    # not joined: PostgreSQL would read the whole table for each batch
    day_status = (
        sa.select(DiaryDay.status)
        .where(DiaryDay.participant_id == Meal.participant_id, DiaryDay.local_date == Meal.local_date)
        .scalar_subquery()
    )
    query: AnyQuery = (
        sa.select(
            stored_id(Meal.id),
            stored_id(Meal.client_id),
            Meal.captured_at,
            Meal.utc_offset_minutes,
            Meal.time_zone,
            Meal.local_date,
            Meal.received_at,
            stored_id(Meal.study_id),
            stored_id(Meal.participant_id),
            sa.func.coalesce(day_status, "open"),
        )
        .select_from(Meal)
        .where(one_of(Meal.id, is_on_sqlite=is_on_sqlite))
    )
    return query.add_columns(*coordinates()).join(Study, Study.id == Meal.study_id) if with_point else query


def one_of(column: AnyColumn, *, is_on_sqlite: bool) -> sa.ColumnElement[bool]:
    """Whether an id is one of those that rows_of_ids is given: one parameter, however many they are."""
    ids: Any = sa.bindparam(IDS, type_=sa.Text() if is_on_sqlite else postgresql.ARRAY(sa.Text))
    if is_on_sqlite:
        return stored_id(column).in_(sa.select(sa.func.json_each(ids).table_valued("value").c.value))
    condition: sa.ColumnElement[bool] = column == sa.any_(sa.cast(ids, postgresql.ARRAY(sa.Uuid)))
    return condition


def rows_of_ids(connection: sa.Connection, query: AnyQuery, ids: Collection[str], *, is_on_sqlite: bool) -> Rows:
    """All rows of a query with one_of, as the driver gives them."""
    result = connection.execute(query, {IDS: json.dumps(sorted(ids)) if is_on_sqlite else sorted(ids)})
    rows: Rows = result.cursor.fetchall()
    result.close()
    return rows


def coordinates() -> tuple[AnyColumn, AnyColumn]:
    """Longitude and latitude of a meal whose study keeps locations; for a query of meals with their Study."""
    keeps = Study.location_policy != "drop"  # a study that keeps them no longer does not show those that it has
    place = Meal.details["location"]
    return tuple(sa.case((keeps, place[name].as_float())) for name in ("longitude", "latitude"))  # type: ignore[return-value]  # two of them


def point_of(longitude: float | None, latitude: float | None) -> tuple[float | None, float | None]:
    """Both, or neither."""
    return (float(longitude), float(latitude)) if longitude is not None and latitude is not None else NOWHERE


def _instants(stored: Sequence[str] | Sequence[datetime]) -> Sequence[datetime]:
    """Instants of SQLite, which stores texts without a zone, or of PostgreSQL."""
    return [datetime.fromisoformat(f"{text}Z") if isinstance(text, str) else text for text in stored]


def _instant_texts(stored: Sequence[str] | Sequence[datetime]) -> list[str]:
    """The same as JSON has them."""
    return [
        f"{instant.replace(' ', 'T').removesuffix('.000000')}Z" if isinstance(instant, str) else instant_text(instant)
        for instant in stored
    ]


def _day(value: str | date) -> tuple[str, int]:
    """A day as JSON has it, and its ordinal. From SQLite's text, or PostgreSQL's day."""
    day = date.fromisoformat(value) if isinstance(value, str) else value
    return day.isoformat(), day.toordinal()


def hyphenated(ids: Sequence[str]) -> Sequence[str]:
    """Return ids as they are written elsewhere; in a quarter of the time that uuid.UUID would take."""
    if not ids or len(ids[0]) > HEX_DIGITS:
        return ids
    return [f"{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:]}" for text in ids]


def _studies(session: Session, ids: Collection[str]) -> dict[str, str]:
    codes: dict[str, str] = {}
    query = sa.select(Study.id, Study.code).where(Study.id.in_([uuid.UUID(text) for text in ids]))
    for study_id, code in session.execute(query):
        codes |= dict.fromkeys(spellings(study_id), code)
    return codes


def _people(session: Session, ids: Collection[str]) -> dict[str, _Person]:
    every = [uuid.UUID(text) for text in ids]
    first = first_days(session, every)
    people: dict[str, _Person] = {}
    for participant_id, code in session.execute(
        sa.select(Participant.id, Participant.code).where(Participant.id.in_(every))
    ):
        day = first.get(participant_id)
        people |= dict.fromkeys(spellings(participant_id), _Person(code, None if day is None else day.toordinal()))
    return people


def _foods(session: Session, ids: Collection[int | None]) -> dict[int | None, _Food]:
    query = (
        sa.select(Food.id, Food.key, Food.name, FoodRelease.name + " " + FoodRelease.version, Food.version)
        .join(FoodRelease, FoodRelease.id == Food.release_id)
        .where(Food.id.in_([each for each in ids if each is not None]))
    )
    foods: dict[int | None, _Food] = {None: _Food((None, None, None), None)}
    return foods | {
        food_id: _Food((key, name, table), version) for food_id, key, name, table, version in session.execute(query)
    }


def spellings(id_: uuid.UUID) -> tuple[str, str]:
    """An id as PostgreSQL's text of it, and as SQLite keeps it."""
    return str(id_), id_.hex
