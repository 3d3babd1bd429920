"""Millions of effective records, made up, with the studies, people, meals, days and foods around them.

As a large deployment might look after three years: 20 studies of 60 % to 0.1 % of the participants, 800 foods by Zipf's
law (every second of the first 400 in two releases), a participant's day of three meals, 2.75 items a meal; 85 % of the
records confirmed, 10 % in need of review (half of them without food and grams), the rest of rare statuses. Rows lie in
the order of time, as they would have arrived. Or, by a Shape, as one large study has it.
"""

import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, Self

import numpy as np
import pyarrow as pa
import sqlalchemy as sa
from pyarrow import csv

from app.db.base import Base  # fmt: skip
from app.db.session import Database
from app.foods.models import Food, FoodActivation, FoodRelease  # fmt: skip
from app.meals.stored.event_models import DiaryDay  # fmt: skip
from app.meals.stored.models import Meal  # fmt: skip
from app.meals.stored.record_models import EffectiveRecord, Item  # fmt: skip
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Device, Participant, Study  # fmt: skip

STUDIES, PEOPLE, FOODS, FOODS_TWICE = 20, 10_000, 800, 200
FIRST_DAY, DAYS = date(2024, 1, 1), 1095
MEAL_HOURS = (7.5, 12.5, 19.0)
ITEMS_A_MEAL, ITEM_SHARES = (1, 2, 3, 4, 5), (0.2, 0.25, 0.25, 0.2, 0.1)
MEAN_ITEMS = 2.75
STATUSES = ("confirmed", "needs_review", "corrected", "rejected", "proposed")
STATUS_SHARES = (0.85, 0.10, 0.045, 0.004, 0.001)
ROWS_A_BATCH = 50_000
CLOSED_SHARE, PROVISIONAL_SHARE, REVIEWED_SHARE = 0.7, 0.0005, 0.3
NOW = datetime(2026, 12, 31)  # noqa: DTZ001  # UTC, as all instants here: Arrow's and NumPy's have no zone
LOADED = (
    "effective_record",
    "item",
    "meal",
    "diary_day",
)  # tables whose indexes are made when they are full


@dataclass(frozen=True, slots=True)
class Shape:
    """How the records are spread. largest: the share of the participants who are in the first study.

    has_places: studies keep where meals were eaten. has_profiles: it is known who most participants are.
    """

    largest: float = 0.6
    days: int = DAYS
    has_places: bool = False
    has_profiles: bool = False


SPREAD = Shape()
ONE_STUDY = Shape(
    largest=0.95, days=365, has_places=True, has_profiles=True
)  # nearly all in one study, within a year


# Names to values: a NumPy or Arrow array, a list, or one value for all rows. Ids are 32 hexadecimal digits.
Columns = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Ground:
    """What the records stand on: ids by number, and which study a participant is in."""

    study_ids: np.ndarray[Any, Any]
    person_ids: np.ndarray[Any, Any]
    device_ids: np.ndarray[Any, Any]
    study_of: np.ndarray[Any, Any]


def study_shares(largest: float = SPREAD.largest) -> np.ndarray[Any, Any]:
    """The largest, and the others in a geometric row: after 60 %, down to 0.1 %."""
    rest = np.geomspace(0.0946, 0.001, STUDIES - 1)
    return np.concatenate([[largest], rest * (1.0 - largest) / rest.sum()])


def food_key(rank: int) -> str:
    """The key of the food of this rank, 0 the commonest."""
    return f"food-{rank:04d}"


def fill(
    database: Database, rows: int, seed: int, tell: Any = print, shape: Shape = SPREAD
) -> None:
    """Fill a migrated, empty database with at least so many records, and let the planner know."""
    rng = np.random.default_rng(seed)
    with Loader(database) as loader:
        ground = lay_ground(loader, rng, shape)
        done = 0
        for batch in batches(ground, rows, rng, shape):
            for model, columns in batch:
                loader.insert(model, columns)
            done += len(batch[-1][1]["item_id"])
            if done // 1_000_000 != (done - ROWS_A_BATCH) // 1_000_000:
                tell(f"  {done:,} records")
        tell(f"  {done:,} records; indexes")


def lay_ground(loader: "Loader", rng: np.random.Generator, shape: Shape = SPREAD) -> Ground:
    """Studies, participants with a phone each, two food releases."""
    study_ids, person_ids, device_ids = _ids(rng, STUDIES), _ids(rng, PEOPLE), _ids(rng, PEOPLE)
    study_of = np.sort(rng.choice(STUDIES, PEOPLE, p=study_shares(shape.largest)))
    study_of[-STUDIES:] = np.maximum(
        study_of[-STUDIES:], np.arange(STUDIES)
    )  # nobody's study is empty
    study_of.sort()
    loader.insert(
        Study,
        {"id": study_ids, "code": [f"study-{n:02d}" for n in range(STUDIES)], "name": "A study",
         "change_seq": 10**9, "created_at": NOW, "location_policy": "keep" if shape.has_places else "drop"},
    )  # fmt: skip
    loader.insert(
        Participant,
        {"id": person_ids, "study_id": study_ids[study_of], "code": [f"P{n:05d}" for n in range(PEOPLE)],
         "alias": _ids(rng, PEOPLE), "created_at": NOW}
        | ({"profile": profiles(PEOPLE, rng.spawn(1)[0])} if shape.has_profiles else {}),
    )  # fmt: skip
    loader.insert(
        Device,
        {"id": device_ids, "participant_id": person_ids, "name": "phone", "enrolled_at": NOW},
    )
    loader.insert(
        FoodRelease,
        {"id": [1001, 1002], "source": "csv", "name": "made up", "version": ["1", "2"],
         "released_on": [date(2024, 1, 1), date(2025, 1, 1)], "checksum": ["1" * 64, "2" * 64],
         "imported_at": NOW, "completed_at": NOW},
    )  # fmt: skip
    loader.insert(
        FoodActivation,
        {
            "id": [1001],
            "name": "made up",
            "release_id": [1001],
            "author": "benchmark",
            "activated_at": NOW,
        },
    )
    ranks = np.array([*range(FOODS), *range(0, 2 * FOODS_TWICE, 2)])
    is_twice = np.arange(len(ranks)) >= FOODS
    loader.insert(
        Food,
        {"id": food_id(ranks, twice=is_twice), "release_id": np.where(is_twice, 1002, 1001),
         "key": [food_key(rank) for rank in ranks],
         "name": [f"A food, boiled, without salt, number {rank}" for rank in ranks], "food_group": "all",
         "form": "heap", "aliases": "[]", "refuse": "[]", "probes": "[]", "source_ids": "{}"},
    )  # fmt: skip
    return Ground(study_ids, person_ids, device_ids, study_of)


def food_id(rank: Any, *, twice: Any) -> Any:
    """Of numbers or arrays; twice: in the second release."""
    return 100_000 + rank + 10_000 * twice


Batch = list[tuple[type[Base], Columns]]


def batches(
    ground: Ground, rows: int, rng: np.random.Generator, shape: Shape = SPREAD
) -> Iterator[Batch]:
    """Days, meals, items and records, in the order of time, some days a batch."""
    active = max(1, min(PEOPLE, round(rows / MEAN_ITEMS / shape.days / len(MEAL_HOURS))))
    days_a_batch = max(1, round(ROWS_A_BATCH / (active * len(MEAL_HOURS) * MEAN_ITEMS)))
    done, day = 0, 0
    while done < rows:
        count = min(days_a_batch, shape.days - day) if day < shape.days else days_a_batch
        batch = some_days(ground, day, count, active, done, rng, has_places=shape.has_places)
        done += len(batch[-1][1]["item_id"])
        day += count
        yield batch


def some_days(
    ground: Ground,
    day: int,
    count: int,
    active: int,
    done: int,
    rng: np.random.Generator,
    *,
    has_places: bool = False,
) -> Batch:
    """The rows of `count` days from the day of this number on; done: records before them."""
    people = np.concatenate([rng.choice(PEOPLE, active, replace=False) for _ in range(count)])
    day_of = np.repeat(np.arange(day, day + count), active)
    kept = np.flatnonzero(rng.random(len(people)) < CLOSED_SHARE)
    diary = {
        "participant_id": ground.person_ids[people[kept]],
        "local_date": _day(day_of[kept]),
        "id": _ids(rng, len(kept)),
        "study_id": ground.study_ids[ground.study_of[people[kept]]],
        "status": "closed",
        "ate_nothing": False,
        "version": 1,
        "changed_at": NOW,
        "change_seq": done + np.arange(len(kept)),
    }
    meal_people = np.tile(people, len(MEAL_HOURS))
    meal_days = np.tile(day_of, len(MEAL_HOURS))
    hours = np.repeat(MEAL_HOURS, len(people)) + rng.normal(0.0, 0.7, len(meal_people))
    microseconds = ((meal_days * 86400 + hours * 3600) * 1e6).astype(np.int64)
    order = np.argsort(microseconds)
    meal_people, meal_days, microseconds = meal_people[order], meal_days[order], microseconds[order]
    captured = np.datetime64(FIRST_DAY, "us") + microseconds
    meals = len(captured)
    meal_ids = _ids(rng, meals)
    meal_study, meal_person = (
        ground.study_ids[ground.study_of[meal_people]],
        ground.person_ids[meal_people],
    )
    meal_date = _day(meal_days)
    meal = {
        "id": meal_ids, "client_id": _ids(rng, meals), "study_id": meal_study, "participant_id": meal_person,
        "device_id": ground.device_ids[meal_people], "alias": _ids(rng, meals),
        "origin": "declared", "captured_at": captured, "utc_offset_minutes": 0,
        "time_zone": "Etc/UTC", "local_date": meal_date,
        "details": places(meals, rng) if has_places else "{}",
        "status": "confirmed", "version": 1, "received_at": captured + np.timedelta64(3, "m"),
    }  # fmt: skip
    of_meal = np.repeat(np.arange(meals), rng.choice(ITEMS_A_MEAL, meals, p=ITEM_SHARES))
    items = len(of_meal)
    item_ids = _ids(rng, items)
    item = {
        "id": item_ids, "meal_id": meal_ids[of_meal], "origin": "declared", "position": 0, "rings": "[]",
        "relative_sd": "{}", "flags": "[]", "traits": "{}",
    }  # fmt: skip
    of_item = {
        "item_id": item_ids,
        "meal_id": meal_ids[of_meal],
        "study_id": meal_study[of_meal],
        "participant_id": meal_person[of_meal],
        "captured_at": captured[of_meal],
        "local_date": meal_date[of_meal],
        "change_seq": done + np.arange(items),
    }
    return [
        (DiaryDay, diary),
        (Meal, meal),
        (Item, item),
        (EffectiveRecord, of_item | measured(items, rng)),
    ]


def places(count: int, rng: np.random.Generator) -> list[str]:
    """Details of meals that were eaten in and around a town."""
    return [
        f'{{"location": {{"latitude": {latitude:.5f}, "longitude": {longitude:.5f}}}}}'
        for latitude, longitude in zip(
            rng.normal(48.2, 0.1, count), rng.normal(16.4, 0.15, count), strict=True
        )
    ]


def profiles(count: int, rng: np.random.Generator) -> list[str | None]:
    """Who participants are, from 9 to 85 years old; of one in twenty nobody knows."""
    age = rng.integers(9, 86, count)
    weight_kg = np.minimum(10.0 + 3.4 * age, 75.0) * rng.lognormal(0.0, 0.15, count)
    return [
        f'{{"sex": "{sex}", "birth_year": {FIRST_DAY.year - years}, "weight_kg": {kg:.1f}}}'
        if is_known
        else None
        for sex, years, kg, is_known in zip(
            rng.choice(["female", "male"], count),
            age,
            weight_kg,
            rng.random(count) >= 0.05,
            strict=True,
        )
    ]


def measured(count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Status, food and amounts of so many records."""
    status = rng.choice(len(STATUSES), count, p=STATUS_SHARES)
    weights = 1.0 / np.arange(1, FOODS + 1)
    ranks = rng.choice(FOODS, count, p=weights / weights.sum())
    is_twice = (ranks % 2 == 0) & (ranks < 2 * FOODS_TWICE) & (rng.random(count) < 0.5)
    unknown = (status == STATUSES.index("needs_review")) & (rng.random(count) < 0.5)
    volume = rng.lognormal(5.0, 0.6, count)
    density = rng.normal(0.9, 0.1, count)
    grams = volume * density
    hidden = unknown | (status == STATUSES.index("rejected"))
    columns: dict[str, Any] = {
        "status": np.array(STATUSES, "S")[status],
        "origin": "declared",
        "provisional": rng.random(count) < PROVISIONAL_SHARE,
        "reviewed": rng.random(count) < REVIEWED_SHARE,
        "food_id": pa.array(food_id(ranks, twice=is_twice), mask=unknown),
        "volume_ml": volume,
        "volume_low_ml": volume * 0.8,
        "volume_high_ml": volume * 1.2,
        "density_g_per_ml": pa.array(density, mask=unknown),
        "density_source": pa.array(np.full(count, "FAO/INFOODS 2012"), mask=unknown),
        "share": 1.0,
        "flags": np.array(["[]", '["estimated_from_one_view"]'], "S")[
            rng.choice(2, count, p=(0.9, 0.1))
        ],
        "doubt": rng.random(count),
        "details": '{"rings": null, "served": null, "left": [], "open_probes": []}',
    }
    for name, factor in (("mass_g", 1.0), ("mass_low_g", 0.75), ("mass_high_g", 1.25), ("edible_g", 0.95),
                         ("consumed_g", 0.95), ("consumed_low_g", 0.7), ("consumed_high_g", 1.2)):  # fmt: skip
        columns[name] = pa.array(grams * factor, mask=hidden)
    for number, name in enumerate(HEADLINE_COLUMNS):
        columns[name] = pa.array(grams * (1.5 if number == 0 else 0.03 * number), mask=hidden)
    return columns


class Loader:
    """Writes without the database's checks and second indexes, which are made anew at the end: minutes, not hours."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._made_later: list[str] = []

    def __enter__(self) -> Self:
        self._connection = self._database.write_engine.raw_connection()
        cursor = self._connection.cursor()
        if self._database.is_sqlite:
            for pragma in ("foreign_keys = OFF", "synchronous = OFF", "cache_size = -200000"):
                cursor.execute(f"PRAGMA {pragma}")
            found = cursor.execute(
                "SELECT name, sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL "
                f"AND tbl_name IN {LOADED} AND sql NOT LIKE '%UNIQUE%'"
            ).fetchall()
            cursor.execute("BEGIN IMMEDIATE")
        else:
            cursor.execute(
                "SET session_replication_role = replica"
            )  # no checks of references, row by row
            cursor.execute(
                "SET statement_timeout = 0; SET maintenance_work_mem = '1GB'; SET synchronous_commit = off"
            )
            cursor.execute(
                "SELECT indexname, indexdef FROM pg_indexes WHERE schemaname = 'public' AND indexname LIKE 'ix_%' "
                f"AND tablename IN {LOADED}"
            )
            found = cursor.fetchall()
        for name, sql in found:
            cursor.execute(f"DROP INDEX {name}")
            self._made_later.append(sql)
        return self

    def insert(self, model: type[Base], columns: Columns) -> None:
        """Rows of these columns; what is left out of a NOT NULL column gets the model's own default."""
        table = model.__table__
        assert isinstance(table, sa.Table)
        filled = dict(columns)
        for column in table.columns:
            if column.name not in filled and not column.nullable and column.default is not None:
                filled[column.name] = _default(column.default)
        count = max(
            len(values) for values in filled.values() if isinstance(values, list | np.ndarray)
        )
        arrays = {name: _array(values, count) for name, values in filled.items()}
        cursor, names = self._connection.cursor(), ", ".join(arrays)
        if self._database.is_sqlite:
            marks = ", ".join("?" * len(arrays))
            rows = zip(*(_stored(array) for array in arrays.values()), strict=True)
            cursor.executemany(f"INSERT INTO {table.name} ({names}) VALUES ({marks})", rows)
            return
        buffer = io.BytesIO()
        csv.write_csv(pa.table(arrays), buffer, csv.WriteOptions(include_header=False))
        with cursor.copy(f"COPY {table.name} ({names}) FROM STDIN (FORMAT csv)") as copy:
            copy.write(buffer.getbuffer())

    def __exit__(self, *raised: object) -> None:
        cursor = self._connection.cursor()
        if raised[0] is None:
            if not self._database.is_sqlite:
                self._connection.commit()
                cursor.execute("SET statement_timeout = 0")
            for sql in self._made_later:
                cursor.execute(sql)
            self._connection.commit()
            cursor.execute("ANALYZE")  # without it the sums of some thousand days read whole tables
            self._connection.commit()
            if not self._database.is_sqlite:
                self._connection.dbapi_connection.autocommit = True
                cursor.execute("SET statement_timeout = 0")
                cursor.execute("VACUUM ANALYZE")
        self._connection.invalidate()


def _default(default: Any) -> Any:
    """The value of a model's default; an empty list or object as its JSON."""
    return json.dumps(default.arg(None)) if default.is_callable else default.arg


def _array(values: Any, count: int) -> pa.Array:
    if isinstance(values, pa.Array):
        return values
    if isinstance(values, list | np.ndarray):
        array = pa.array(values)
        return array.cast(pa.string()) if pa.types.is_binary(array.type) else array
    return pa.repeat(pa.scalar(values), count)


def _stored(array: pa.Array) -> list[Any]:
    """As SQLite keeps it: instants and days as text."""
    return (array.cast(pa.string()) if pa.types.is_temporal(array.type) else array).to_pylist()


def _ids(rng: np.random.Generator, count: int) -> np.ndarray[Any, Any]:
    return np.frombuffer(rng.bytes(16 * count).hex().encode(), "S32")


def _day(number: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.datetime64(FIRST_DAY, "D") + number
