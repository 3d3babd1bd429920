"""Millions of effective records, made up, with the studies, people, meals, days and foods around them.

As a large deployment might look after three years: 20 studies of 60 % to 0.1 % of the participants, 800 foods by Zipf's
law (every second of the first 400 in two releases), a participant's day of three meals, 2.75 items a meal; 85 % of the
records confirmed, 10 % in need of review (half of them without food and grams), the rest of rare statuses. Rows lie in
the order of time, as they would have arrived.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Any, Self

import numpy as np
import sqlalchemy as sa

from app.db.models import (
    Base,
    Device,
    DiaryDay,
    EffectiveRecord,
    Food,
    FoodRelease,
    Item,
    Meal,
    Participant,
    Study,
)  # fmt: skip
from app.db.models.record import HEADLINE_COLUMNS
from app.db.session import Database

STUDIES, PEOPLE, FOODS, FOODS_TWICE = 20, 10_000, 800, 200
FIRST_DAY, DAYS = date(2024, 1, 1), 1095
MEAL_HOURS = (7.5, 12.5, 19.0)
ITEMS_A_MEAL, ITEM_SHARES = (1, 2, 3, 4, 5), (0.2, 0.25, 0.25, 0.2, 0.1)
MEAN_ITEMS = 2.75
STATUSES = ("confirmed", "needs_review", "corrected", "rejected", "proposed")
STATUS_SHARES = (0.85, 0.10, 0.045, 0.004, 0.001)
ROWS_A_BATCH = 50_000
NOW = datetime(2026, 12, 31, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Ground:
    """What the records stand on: ids by number, and which study a participant is in."""

    study_ids: list[str]
    person_ids: list[str]
    device_ids: list[str]
    study_of: np.ndarray[Any, Any]


def study_shares() -> np.ndarray[Any, Any]:
    """60 %, and the others in a geometric row down to 0.1 %."""
    rest = np.geomspace(0.0946, 0.001, STUDIES - 1)
    return np.concatenate([[0.6], rest * 0.4 / rest.sum()])


def food_key(rank: int) -> str:
    """The key of the food of this rank, 0 the commonest."""
    return f"food-{rank:04d}"


def fill(database: Database, rows: int, seed: int, tell: Any = print) -> None:
    """Fill a migrated, empty database with at least so many records, and let the planner know."""
    rng = np.random.default_rng(seed)
    with Loader(database) as loader:
        ground = lay_ground(loader, rng)
        done = 0
        for batch in batches(ground, rows, rng):
            for model, columns in batch:
                loader.insert(model, columns)
            done += len(batch[-1][1]["item_id"])
            if done // 1_000_000 != (done - ROWS_A_BATCH) // 1_000_000:
                tell(f"  {done:,} records")
        tell(f"  {done:,} records; indexes")


def lay_ground(loader: "Loader", rng: np.random.Generator) -> Ground:
    """Studies, participants with a phone each, two food releases."""
    study_ids, person_ids, device_ids = _ids(rng, STUDIES), _ids(rng, PEOPLE), _ids(rng, PEOPLE)
    study_of = np.sort(rng.choice(STUDIES, PEOPLE, p=study_shares()))
    study_of[-STUDIES:] = np.maximum(study_of[-STUDIES:], np.arange(STUDIES))  # nobody's study is empty
    study_of.sort()
    loader.insert(
        Study,
        {"id": study_ids, "code": [f"study-{n:02d}" for n in range(STUDIES)], "name": ["A study"] * STUDIES,
         "change_seq": [10**9] * STUDIES, "created_at": [_instant(NOW)] * STUDIES},
    )  # fmt: skip
    loader.insert(
        Participant,
        {"id": person_ids, "study_id": [study_ids[n] for n in study_of], "code": [f"P{n:05d}" for n in range(PEOPLE)],
         "alias": _ids(rng, PEOPLE), "created_at": [_instant(NOW)] * PEOPLE},
    )  # fmt: skip
    loader.insert(
        Device,
        {"id": device_ids, "participant_id": person_ids, "name": ["phone"] * PEOPLE,
         "enrolled_at": [_instant(NOW)] * PEOPLE},
    )  # fmt: skip
    loader.insert(
        FoodRelease,
        {"id": [1001, 1002], "source": ["benchmark"] * 2, "name": ["made up"] * 2, "version": ["1", "2"],
         "released_on": ["2024-01-01", "2025-01-01"], "checksum": ["1" * 64, "2" * 64],
         "imported_at": [_instant(NOW)] * 2, "completed_at": [_instant(NOW)] * 2},
    )  # fmt: skip
    ranks = [*range(FOODS), *range(0, 2 * FOODS_TWICE, 2)]
    count = len(ranks)
    loader.insert(
        Food,
        {"id": [food_id(rank, twice=n >= FOODS) for n, rank in enumerate(ranks)],
         "release_id": [1001] * FOODS + [1002] * FOODS_TWICE, "key": [food_key(rank) for rank in ranks],
         "name": [f"A food, boiled, without salt, number {rank}" for rank in ranks], "food_group": ["all"] * count,
         "form": ["heap"] * count}
        | dict.fromkeys(("aliases", "refuse", "probes"), ["[]"] * count)
        | {"source_ids": ["{}"] * count},
    )  # fmt: skip
    return Ground(study_ids, person_ids, device_ids, study_of)


def food_id(rank: int, *, twice: bool) -> int:
    return 100_000 + rank + (10_000 if twice else 0)


Batch = list[tuple[type[Base], Mapping[str, Sequence[Any]]]]


def batches(ground: Ground, rows: int, rng: np.random.Generator) -> Iterator[Batch]:
    """Days, meals, items and records, in the order of time, some days a batch."""
    active = max(1, min(PEOPLE, round(rows / MEAN_ITEMS / DAYS / len(MEAL_HOURS))))
    days_a_batch = max(1, round(ROWS_A_BATCH / (active * len(MEAL_HOURS) * MEAN_ITEMS)))
    done, day = 0, 0
    while done < rows:
        count = min(days_a_batch, DAYS - day) if day < DAYS else days_a_batch
        batch = some_days(ground, day, count, active, done, rng)
        done += len(batch[-1][1]["item_id"])
        day += count
        yield batch


def some_days(ground: Ground, day: int, count: int, active: int, done: int, rng: np.random.Generator) -> Batch:
    people = np.concatenate([rng.choice(PEOPLE, active, replace=False) for _ in range(count)])
    day_of = np.repeat(np.arange(day, day + count), active)
    texts = [(FIRST_DAY + timedelta(days=n)).isoformat() for n in range(day, day + count)]
    closed = rng.random(len(people)) < 0.7
    kept = np.flatnonzero(closed).tolist()
    diary = {
        "participant_id": [ground.person_ids[people[n]] for n in kept],
        "local_date": [texts[day_of[n] - day] for n in kept],
        "id": _ids(rng, len(kept)),
        "study_id": [ground.study_ids[ground.study_of[people[n]]] for n in kept],
        "status": ["closed"] * len(kept),
        "ate_nothing": [False] * len(kept),
        "version": [1] * len(kept),
        "changed_at": [_instant(NOW)] * len(kept),
        "change_seq": [done + n for n in range(len(kept))],
    }
    meal_people = np.tile(people, len(MEAL_HOURS))
    meal_days = np.tile(day_of, len(MEAL_HOURS))
    hours = np.repeat(MEAL_HOURS, len(people)) + rng.normal(0.0, 0.7, len(meal_people))
    seconds = (meal_days * 86400 + hours * 3600).round(6)
    order = np.argsort(seconds)
    meal_people, meal_days, seconds = meal_people[order], meal_days[order], seconds[order]
    start = datetime(FIRST_DAY.year, FIRST_DAY.month, FIRST_DAY.day, tzinfo=UTC)
    instants = [start + timedelta(seconds=value) for value in seconds.tolist()]
    captured = [_instant(instant) for instant in instants]
    meals = len(captured)
    meal_ids = _ids(rng, meals)
    meal_study = [ground.study_ids[n] for n in ground.study_of[meal_people]]
    meal_person = [ground.person_ids[n] for n in meal_people]
    meal_date = [texts[n - day] for n in meal_days]
    meal = {
        "id": meal_ids, "client_id": _ids(rng, meals), "study_id": meal_study, "participant_id": meal_person,
        "device_id": [ground.device_ids[n] for n in meal_people], "alias": _ids(rng, meals),
        "origin": ["declared"] * meals, "captured_at": captured, "utc_offset_minutes": [0] * meals,
        "time_zone": ["Etc/UTC"] * meals, "local_date": meal_date, "details": ["{}"] * meals,
        "status": ["confirmed"] * meals, "version": [1] * meals,
        "received_at": [_instant(instant + timedelta(minutes=3)) for instant in instants],
    }  # fmt: skip
    of_meal = np.repeat(np.arange(meals), rng.choice(ITEMS_A_MEAL, meals, p=ITEM_SHARES)).tolist()
    items = len(of_meal)
    item_ids = _ids(rng, items)
    item = {
        "id": item_ids, "meal_id": [meal_ids[n] for n in of_meal], "origin": ["declared"] * items,
        "position": [0] * items, "rings": ["[]"] * items, "relative_sd": ["{}"] * items, "flags": ["[]"] * items,
        "traits": ["{}"] * items,
    }  # fmt: skip
    of_item: dict[str, list[Any]] = {
        "item_id": item_ids,
        "meal_id": item["meal_id"],
        "study_id": [meal_study[n] for n in of_meal],
        "participant_id": [meal_person[n] for n in of_meal],
        "captured_at": [captured[n] for n in of_meal],
        "local_date": [meal_date[n] for n in of_meal],
        "change_seq": [done + n for n in range(items)],
    }
    return [(DiaryDay, diary), (Meal, meal), (Item, item), (EffectiveRecord, of_item | measured(items, rng))]


def measured(count: int, rng: np.random.Generator) -> dict[str, list[Any]]:
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

    def known(values: np.ndarray[Any, Any], missing: np.ndarray[Any, Any]) -> list[float | None]:
        return [None if gone else value for value, gone in zip(values.tolist(), missing.tolist(), strict=True)]

    columns: dict[str, list[Any]] = {
        "status": [STATUSES[n] for n in status],
        "origin": ["declared"] * count,
        "provisional": (rng.random(count) < 0.0005).tolist(),
        "reviewed": (rng.random(count) < 0.3).tolist(),
        "food_id": [
            None if gone else food_id(rank, twice=twice)
            for rank, twice, gone in zip(ranks.tolist(), is_twice.tolist(), unknown.tolist(), strict=True)
        ],
        "volume_ml": volume.tolist(),
        "volume_low_ml": (volume * 0.8).tolist(),
        "volume_high_ml": (volume * 1.2).tolist(),
        "density_g_per_ml": known(density, unknown),
        "density_source": [None if gone else "FAO/INFOODS 2012" for gone in unknown],
        "share": [1.0] * count,
        "left_g": [None] * count,
        "flags": [("[]", '["estimated_from_one_view"]')[n] for n in rng.choice(2, count, p=(0.9, 0.1))],
        "doubt": rng.random(count).tolist(),
    }
    for name, factor in (("mass_g", 1.0), ("mass_low_g", 0.75), ("mass_high_g", 1.25), ("edible_g", 0.95),
                         ("consumed_g", 0.95), ("consumed_low_g", 0.7), ("consumed_high_g", 1.2)):  # fmt: skip
        columns[name] = known(grams * factor, hidden)
    for number, name in enumerate(HEADLINE_COLUMNS):
        columns[name] = known(grams * (1.5 if number == 0 else 0.03 * number), hidden)
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
                "AND tbl_name IN ('effective_record', 'item', 'meal', 'diary_day') AND sql NOT LIKE '%UNIQUE%'"
            ).fetchall()
            cursor.execute("BEGIN IMMEDIATE")
        else:
            cursor.execute("SET session_replication_role = replica")  # no checks of references, row by row
            cursor.execute("SET statement_timeout = 0; SET maintenance_work_mem = '1GB'; SET synchronous_commit = off")
            cursor.execute(
                "SELECT indexname, indexdef FROM pg_indexes WHERE schemaname = 'public' AND indexname LIKE 'ix_%' "
                "AND tablename IN ('effective_record', 'item', 'meal', 'diary_day')"
            )
            found = cursor.fetchall()
        for name, sql in found:
            cursor.execute(f"DROP INDEX {name}")
            self._made_later.append(sql)
        return self

    def insert(self, model: type[Base], columns: Mapping[str, Sequence[Any]]) -> None:
        """Rows of these columns; what is left out of a NOT NULL column gets the model's own default."""
        table = model.__table__
        assert isinstance(table, sa.Table)
        count = len(next(iter(columns.values())))
        filled = dict(columns)
        for column in table.columns:
            if column.name not in filled and not column.nullable and column.default is not None:
                filled[column.name] = [column.default.arg] * count
        cursor = self._connection.cursor()
        names = ", ".join(filled)
        if self._database.is_sqlite:
            marks = ", ".join("?" * len(filled))
            rows = zip(*filled.values(), strict=True)
            cursor.executemany(f"INSERT INTO {table.name} ({names}) VALUES ({marks})", rows)
            return
        texts = [[_copied(value) for value in values] for values in filled.values()]
        buffer = io.StringIO()
        buffer.writelines("\t".join(row) + "\n" for row in zip(*texts, strict=True))
        with cursor.copy(f"COPY {table.name} ({names}) FROM STDIN") as copy:
            copy.write(buffer.getvalue())

    def __exit__(self, *raised: object) -> None:
        cursor = self._connection.cursor()
        if raised[0] is None:
            if not self._database.is_sqlite:
                self._connection.commit()
                cursor.execute("SET statement_timeout = 0")
            for sql in self._made_later:
                cursor.execute(sql)
            self._connection.commit()
            if self._database.is_sqlite:
                cursor.execute("ANALYZE")
            else:
                self._connection.dbapi_connection.autocommit = True
                cursor.execute("SET statement_timeout = 0")
                cursor.execute("VACUUM ANALYZE")
        self._connection.invalidate()


def _copied(value: Any) -> str:
    if value is None:
        return "\\N"
    return repr(value) if isinstance(value, float) else str(value)


def _ids(rng: np.random.Generator, count: int) -> list[str]:
    text = rng.bytes(16 * count).hex()
    return [text[32 * n : 32 * n + 32] for n in range(count)]


def _instant(instant: datetime) -> str:
    return instant.strftime("%Y-%m-%d %H:%M:%S.%f")
