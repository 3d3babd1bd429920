"""Removing erased data from a release: the next version of its files, from the former ones alone.

Rows of an erased meal or participant are removed; the day of an erased meal is computed from its
remaining meals (day_without.sql); foods without items are removed too. An anonymised participant
gets a new code and new meal ids, without profile, places, photographs and their hashes. Pending
removals are stored as keyed digests, so that no erased code or id stays in the database.
"""

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import duckdb

from app.exports.live_tables import MACROS, limited_duckdb, with_headlines
from app.exports.release_models import ReleaseChange
from app.exports.releases.digests import meal_digest, participant_digest
from app.exports.releases.freeze_release import create_view, rows_in_order, write_pair
from app.exports.releases.manifest import Manifest
from app.exports.releases.tables import OF_FOODS, PERSONAL_COLUMNS, TABLES
from app.exports.table_columns import without_twins
from app.exports.table_selects import TableSelect
from app.http.columns.day_columns import COUNTS, SUMS
from app.http.columns.dictionary import Column
from app.people.access.secret_box import SecretBox

DAY_WITHOUT = with_headlines(Path(__file__).parent / "day_without.sql")
COUNTED = tuple(column.name for column in (*COUNTS, *SUMS))
OF_PEOPLE = ("days", "participants")  # tables without meals
GONE = None
Key = tuple[str, str | None]  # participant, meal


@dataclass(slots=True)
class Verdicts:
    """The new participant and meal of a row, or GONE.

    Changes are found by digest, so that each name is digested once, however many changes there
    are. After a rename the later changes are searched for the new name.
    """

    box: SecretBox
    changes: Sequence[ReleaseChange]
    participant_digests: dict[str, str] = field(default_factory=dict)  # by code
    places_by_digest: dict[str, list[int]] = field(init=False)  # ascending places in changes

    def __post_init__(self) -> None:
        """Index the changes by digest."""
        self.places_by_digest = {}
        for place, change in enumerate(self.changes):
            self.places_by_digest.setdefault(change.digest, []).append(place)

    def __call__(self, participant: str, meal_id: str | None = None) -> Key | None:
        """Apply the changes in their order: who was anonymised may be erased later, by the new code."""
        after = -1
        while (place := self._next_change(participant, meal_id, after)) is not None:
            change, after = self.changes[place], place
            if change.new_code is None or change.new_ids is None:
                return GONE
            participant = change.new_code
            meal_id = str(uuid.uuid5(change.new_ids, meal_id)) if meal_id is not None else None
        return participant, meal_id

    def _next_change(self, participant: str, meal_id: str | None, after: int) -> int | None:
        """Return the place of the first change of this participant or meal after place `after`."""
        if participant not in self.participant_digests:
            self.participant_digests[participant] = participant_digest(self.box, participant)
        digests = [self.participant_digests[participant]]
        if meal_id is not None:
            digests.append(meal_digest(self.box, participant, meal_id))
        places = (
            place
            for digest in digests
            for place in self.places_by_digest.get(digest, ())
            if place > after
        )
        return min(places, default=None)


def alter_tables(
    former: Path, manifest: Manifest, verdicts: Verdicts, folder: Path
) -> dict[str, Any] | None:
    """Write all tables of a release without the erased data.

    former: the folder of the former files.
    Returns what write_pair does, by name; None if the release has nothing of them.
    """
    with limited_duckdb(folder / "spilled") as connection:
        connection.execute(MACROS)
        for name in manifest.tables:
            create_view(connection, name, former)
        changed = _changed(connection, manifest, verdicts)
        if not changed:
            return None
        _create_changes(connection, changed)
        if "days" in manifest.tables:
            _create_days(connection, is_after=manifest.protocol.expects_after_pair)
        tables: dict[str, Any] = {}
        for name in TABLES:
            if name in manifest.tables:  # older releases have no participants
                columns = without_twins(manifest.tables[name])
                table = _remaining(name, columns, former)
                tables[name] = write_pair(connection, name, table, folder)
        create_view(connection, "items", folder)
        for name in OF_FOODS:
            table = _remaining_foods(manifest.tables[name], former / f"{name}.parquet")
            tables[name] = write_pair(connection, name, table, folder)
    return tables


@dataclass(frozen=True, slots=True)
class _Changed:
    """What becomes of a participant (meal None) or of a meal; new: GONE, or its new key."""

    participant: str
    meal_id: str | None
    new: Key | None


def _changed(
    connection: duckdb.DuckDBPyConnection, manifest: Manifest, verdicts: Verdicts
) -> list[_Changed]:
    changed: list[_Changed] = []
    for participant, meal_id in _keys(connection, manifest):
        new = verdicts(participant, meal_id)
        if new != (participant, meal_id):
            changed.append(_Changed(participant, meal_id, new))
    return changed


def _keys(connection: duckdb.DuckDBPyConnection, manifest: Manifest) -> Iterator[Key]:
    yield from connection.execute("SELECT participant, meal_id FROM meals").fetchall()
    tables = [name for name in ("meals", *OF_PEOPLE) if name in manifest.tables]
    people = " UNION ".join(f"SELECT participant FROM {name}" for name in tables)
    for (participant,) in connection.execute(people).fetchall():
        yield participant, None


def _create_changes(connection: duckdb.DuckDBPyConnection, changed: Sequence[_Changed]) -> None:
    """Two tables of what changes: of meals, and of people."""
    for name, is_of_meal in (("changed_meals", True), ("changed_people", False)):
        connection.execute(
            f"CREATE TEMP TABLE {name} (participant VARCHAR, meal_id VARCHAR,"
            " new_participant VARCHAR, new_meal_id VARCHAR, is_gone BOOLEAN, is_renamed BOOLEAN)"
        )
        for change in changed:
            if (change.meal_id is not None) != is_of_meal:
                continue
            new_participant, new_meal_id = change.new or (None, None)
            connection.execute(
                f"INSERT INTO {name} VALUES (?, ?, ?, ?, ?, ?)",  # one of two names
                [
                    change.participant,
                    change.meal_id,
                    new_participant,
                    new_meal_id,
                    change.new is GONE,
                    new_participant is not None and new_participant != change.participant,
                ],
            )


def _create_days(connection: duckdb.DuckDBPyConnection, *, is_after: bool) -> None:
    """The days with an erased meal of a person who stays, as they are `after`."""
    connection.execute(f"SET VARIABLE expects_after_pair = {is_after}")
    gone = (
        "(participant, meal_id) IN (SELECT participant, meal_id FROM changed_meals WHERE is_gone)"
    )
    of_people = "participant NOT IN (SELECT participant FROM changed_people WHERE is_gone)"
    of_days = "(participant, local_date) IN (SELECT participant, local_date FROM meals_gone)"
    for name, select in (
        ("meals_gone", f"SELECT * FROM meals WHERE {gone} AND {of_people}"),
        ("meals_left", f"SELECT * FROM meals WHERE {of_days} AND NOT {gone}"),
        ("items_left", f"SELECT * FROM items WHERE {of_days} AND NOT {gone}"),
        ("before", f"SELECT * FROM days WHERE {of_days}"),
        ("after", DAY_WITHOUT),
    ):
        connection.execute(f"CREATE TEMP TABLE {name} AS {select}")


def _remaining(name: str, columns: tuple[Column, ...], former: Path) -> TableSelect:
    rows, order = rows_in_order(former / f"{name}.parquet")
    is_of_meal = name not in OF_PEOPLE
    changes, key = (
        ("changed_meals", "participant, meal_id")
        if is_of_meal
        else ("changed_people", "participant")
    )
    replaced = ["coalesce(change.new_participant, rows.participant) AS participant"]
    if is_of_meal:
        replaced.append("coalesce(change.new_meal_id, rows.meal_id) AS meal_id")
    replaced += [
        f"CASE WHEN change.is_renamed THEN NULL ELSE rows.{column.name} END AS {column.name}"
        for column in columns
        if column.name in PERSONAL_COLUMNS
    ]
    condition = "NOT coalesce(change.is_gone, false)"
    if name == "photographs":
        condition += " AND NOT coalesce(change.is_renamed, false)"
    if name == "days":
        rows = _days_after(rows)
    join = " AND ".join(f"change.{part} = rows.{part}" for part in key.split(", "))
    sql = (
        f"SELECT rows.* REPLACE ({', '.join(replaced)}) FROM ({rows}) rows"
        f" LEFT JOIN {changes} change ON {join} WHERE {condition}"
    )
    return TableSelect(columns, sql, order)


def _days_after(rows: str) -> str:
    counted = ", ".join(
        f"CASE WHEN old.participant IS NULL THEN rows.{name} ELSE after.{name} END AS {name}"
        for name in COUNTED
    )
    same_day = "{0}.participant = rows.participant AND {0}.local_date = rows.local_date"
    return (
        f"SELECT rows.* REPLACE ({counted}) FROM ({rows}) rows"
        f" LEFT JOIN before old ON {same_day.format('old')}"
        f" LEFT JOIN after ON {same_day.format('after')}"
        " WHERE old.participant IS NULL OR after.participant IS NOT NULL"
    )


def _remaining_foods(columns: tuple[Column, ...], path: Path) -> TableSelect:
    """The rows of foods that still have items; a study's own densities hold for any version."""
    rows, order = rows_in_order(path)
    sql = (
        f"SELECT * FROM ({rows}) WHERE (food_key, food_version, food_table) IN"
        " (SELECT food_key, food_version, food_table FROM items WHERE food_key IS NOT NULL)"
        " OR (food_table IS NULL AND food_key IN"
        " (SELECT food_key FROM items WHERE food_key IS NOT NULL))"
    )
    return TableSelect(columns, sql, order)
