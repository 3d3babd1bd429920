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
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

import sqlalchemy as sa
from psycopg import Cursor, pq
from sqlalchemy.dialects import postgresql
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, AnyQuery
from app.db.stored_ids import stored_id
from app.foods.models import Food, FoodRelease
from app.http.tables.columns import Batch, Cells, ConvertedOnce, Part, PartOfBatch, Row, instant_text
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

ROWS_A_BATCH = 2000
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


class _Meal(NamedTuple):
    of_meal: Row  # the values of OF_MEAL
    of_day: Row  # and of OF_DAY
    point: tuple[float | None, float | None]  # longitude, latitude


class _Food(NamedTuple):
    of_food: tuple[str | None, ...]  # the values of OF_FOOD
    version: int | None


class Keys(NamedTuple):
    """Of a batch's records, in their order: ids as the database tells them as text, and what amounts follow from."""

    item_ids: Sequence[str]
    meal_ids: Sequence[str]
    food_ids: Sequence[int | None]
    food_versions: Sequence[int | None]
    run_ids: Sequence[str | None]
    densities_g_per_ml: Sequence[float | None]
    consumed_g: Sequence[float | None]


More = Callable[[Keys], Mapping[Part, Cells]]


class Lookup(Generic[Id, Known]):
    """What ids stand for, learnt a batch at a time, and forgotten before it is too much."""

    def __init__(self, find: Callable[[Collection[Id]], Mapping[Id, Known]], most_known: int = MOST_KNOWN) -> None:
        self._find, self._most_known, self._known = find, most_known, dict[Id, Known]()

    def __call__(self, ids: Collection[Id]) -> list[Known]:
        """Of each of these, in their order."""
        new = set(ids) - self._known.keys()
        if len(self._known) + len(new) > self._most_known:
            self._known.clear()
            new = set(ids)
        if new:
            self._known.update(self._find(new))
        known = self._known
        return [known[one] for one in ids]


def export_batches(
    session: Session,
    search: RecordSearch | None,
    parts: Sequence[Part] = RECORD_PARTS,
    more: More = lambda _: {},
) -> Iterator[Batch]:
    """All records of a search in the order of (captured_at, item id), a batch of these parts at a time.

    more: gives the rows of those parts that are not known here. In one transaction of the caller's, so that they are
    of one moment.
    """
    if search is None:
        return
    # a meal's records are neighbours
    meals = Lookup(_meal_finder(session, with_point=POINT in parts), most_known=ROWS_A_BATCH)
    foods = Lookup(lambda ids: _foods(session, ids))
    flags, states = ConvertedOnce(_flags), ConvertedOnce(_state)
    for rows in (_one_query if search.is_on_sqlite else _query_by_query)(session.connection(), search):
        own = {part: list(map(itemgetter(place), rows)) for part, place in PLACES.items()}
        item_ids, meal_ids, food_ids, food_versions, run_ids = ([row[place] for row in rows] for place in range(1, 6))
        of_meals, of_foods = meals(meal_ids), foods(food_ids)
        values: dict[Part, Cells] = {
            **own,
            RECORD_ID: [hyphenated(item_id) for item_id in item_ids],
            OF_MEAL: [meal.of_meal for meal in of_meals],
            STATE: states.of(own[STATE]),
            OF_FOOD: [food.of_food for food in of_foods],
            FOOD_VERSION: [food.version for food in of_foods],
            FLAGS: flags.of(own[FLAGS]),
            OF_DAY: [meal.of_day for meal in of_meals],
            POINT: [meal.point for meal in of_meals],
        }
        densities, consumed_g = list(map(DENSITY, own[VOLUME])), list(map(CONSUMED, own[AMOUNTS]))
        values |= more(Keys(item_ids, meal_ids, food_ids, food_versions, run_ids, densities, consumed_g))
        yield [PartOfBatch(part, values[part]) for part in parts]


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


def _meal_finder(session: Session, *, with_point: bool) -> Callable[[Collection[str]], dict[str, _Meal]]:
    """Finds meals by their ids, with what goes with a meal; with_point: where it was too, as far as it is kept."""
    connection, is_on_sqlite = session.connection(), session.get_bind().dialect.name == "sqlite"
    study_codes, people = Lookup(lambda ids: _studies(session, ids)), Lookup(lambda ids: _people(session, ids))
    query, days = _meals(is_on_sqlite=is_on_sqlite, with_point=with_point), ConvertedOnce(_day)

    def find(ids: Collection[str]) -> dict[str, _Meal]:
        rows = rows_of_ids(connection, query, ids, is_on_sqlite=is_on_sqlite)
        meals, studies = {}, study_codes([row[6] for row in rows])
        persons = people([row[7] for row in rows])
        for row, study, person in zip(rows, studies, persons, strict=True):
            meal_id, client_id, captured_at, time_zone, local_date, received_at, _, _, day_status, *point = row
            day, ordinal = days[local_date]
            captured, delay_seconds = _captured(captured_at, received_at)
            of_meal = (hyphenated(client_id), study, person.code, captured, time_zone, day, delay_seconds)
            number = None if person.first_day is None else ordinal - person.first_day + 1
            meals[meal_id] = _Meal(of_meal, (day_status, number), point_of(*point) if point else NOWHERE)
        return meals

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


def _captured(captured_at: str | datetime, received_at: str | datetime) -> tuple[str, float]:
    """An instant as JSON has it, and the seconds to the other one. From SQLite's texts, or PostgreSQL's instants."""
    if isinstance(captured_at, str) or isinstance(received_at, str):
        captured, received = str(captured_at), str(received_at)
        delay = datetime.fromisoformat(received) - datetime.fromisoformat(captured)
        return f"{captured[:10]}T{captured[11:].removesuffix('.000000')}Z", delay.total_seconds()
    return instant_text(captured_at), (received_at - captured_at).total_seconds()


def _day(value: str | date) -> tuple[str, int]:
    """A day as JSON has it, and its ordinal. From SQLite's text, or PostgreSQL's day."""
    day = date.fromisoformat(value) if isinstance(value, str) else value
    return day.isoformat(), day.toordinal()


def hyphenated(text: str) -> str:
    """An id as everybody else writes it; a quarter of what uuid.UUID would take."""
    return text if len(text) > HEX_DIGITS else f"{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:]}"


def _studies(session: Session, ids: Collection[str]) -> dict[str, str]:
    codes: dict[str, str] = {}
    query = sa.select(Study.id, Study.code).where(Study.id.in_([uuid.UUID(one) for one in ids]))
    for study_id, code in session.execute(query):
        codes |= dict.fromkeys(spellings(study_id), code)
    return codes


def _people(session: Session, ids: Collection[str]) -> dict[str, _Person]:
    every = [uuid.UUID(one) for one in ids]
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
        .where(Food.id.in_([one for one in ids if one is not None]))
    )
    foods: dict[int | None, _Food] = {None: _Food((None, None, None), None)}
    return foods | {
        food_id: _Food((key, name, table), version) for food_id, key, name, table, version in session.execute(query)
    }


def spellings(one: uuid.UUID) -> tuple[str, str]:
    """An id as PostgreSQL's text of it, and as SQLite keeps it."""
    return str(one), one.hex
