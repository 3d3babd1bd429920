"""A database with meals in it is brought up to date: rows that others refer to survive, on both kinds."""

import sqlite3
import uuid
from datetime import UTC, date, datetime

import pytest
import sqlalchemy as sa

from app.db.migrate import downgrade, upgrade
from app.db.schema_state import current_revision, is_current
from app.db.session import Database
from app.errors import ConflictError

FIRST = "20261121_first"
CHAIN = ("study", "participant", "device", "meal", "job", "run", "item", "effective_record")
REPLACED = {"run": {"food_release_id"}, "meal": {"deleted_at"}}  # by food_releases; by tombstones
WORDS = {"location_policy": "drop", "state": "done", "status": "confirmed"}  # that the checks allow


@pytest.fixture
def database(database_url):
    """As the first migration leaves it, with one item and its record, and a row in each table that they need."""
    database = Database(database_url)
    upgrade(database, FIRST)
    with database.write() as session:
        schema = sa.MetaData()
        schema.reflect(session.connection())
        for name in CHAIN:
            table = schema.tables[name]
            session.execute(sa.insert(table).values({c.name: value_of(c) for c in table.columns if is_needed(c)}))
    yield database
    database.dispose()


def is_needed(column):
    return not column.nullable


def value_of(column):
    """Something that the column takes; every id of every table is the same one."""
    if column.name in WORDS:
        return WORDS[column.name]
    kind = column.type
    if isinstance(kind, sa.Uuid):
        return uuid.UUID(int=1)
    if isinstance(kind, sa.CHAR):
        return uuid.UUID(int=1).hex
    for known, value in (
        (sa.JSON, {}),
        (sa.DateTime, datetime(2026, 11, 21, tzinfo=UTC)),
        (sa.Date, date(2026, 11, 21)),
        (sa.Integer, 1),
        (sa.Double, 185.0),
    ):
        if isinstance(kind, known):
            return value
    return "x"


def rows_of(database):
    with database.read() as session:
        return {
            table: [dict(row) for row in session.execute(sa.text(f"SELECT * FROM {table}")).mappings()]
            for table in CHAIN
        }


def test_rows_survive_the_upgrade_unchanged(database):
    before = rows_of(database)
    upgrade(database)
    assert is_current(database)
    after = rows_of(database)
    for table, rows in before.items():
        assert len(rows) == len(after[table]) == 1
        shared = rows[0].keys() & after[table][0].keys()
        assert rows[0].keys() - shared <= REPLACED.get(table, set())
        assert {name: rows[0][name] for name in shared} == {name: after[table][0][name] for name in shared}


def test_references_are_enforced_after_the_upgrade(database):
    upgrade(database)
    with pytest.raises(sa.exc.IntegrityError), database.write() as session:
        session.execute(sa.text("DELETE FROM item"))


def test_broken_reference_stops_the_upgrade_and_nothing_is_changed(database):
    if not database.is_sqlite:
        return  # PostgreSQL alters tables in place and lets no reference break
    with sqlite3.connect(database.write_engine.url.database) as connection:  # foreign keys are off
        connection.execute("DELETE FROM run")
    connection.close()
    before = rows_of(database)
    with pytest.raises(sa.exc.IntegrityError, match="refer to none"):
        upgrade(database, "20261121_food_table")
    assert not is_current(database)
    assert rows_of(database) == before
    with pytest.raises(sa.exc.IntegrityError), database.write() as session:
        session.execute(sa.text("DELETE FROM study"))


def test_volume_may_be_unknown_but_only_with_its_interval(database):
    upgrade(database)
    with database.write() as session:
        session.execute(sa.text("UPDATE item SET volume_ml = NULL, volume_low_ml = NULL, volume_high_ml = NULL"))
        session.execute(sa.text("UPDATE effective_record SET volume_ml = NULL"))
    with pytest.raises(sa.exc.IntegrityError), database.write() as session:
        session.execute(sa.text("UPDATE item SET volume_low_ml = 1.0"))


def test_schema_without_unknown_volumes_is_refused_while_there_is_one(database):
    """In words, and with nothing changed, also by the newer migrations that are undone on the way."""
    upgrade(database)
    with database.write() as session:
        session.execute(sa.text("UPDATE effective_record SET volume_ml = NULL"))
    before = rows_of(database)
    with pytest.raises(ConflictError, match="1 rows of effective_record have no volume"):
        downgrade(database, FIRST)
    assert is_current(database)
    assert rows_of(database) == before
    with database.write() as session:
        session.execute(sa.text("UPDATE effective_record SET volume_ml = 185"))
    downgrade(database, FIRST)
    assert current_revision(database) == FIRST


def test_records_status_is_still_one_of_its_words(database):
    upgrade(database)
    with pytest.raises(sa.exc.IntegrityError), database.write() as session:
        session.execute(sa.text("UPDATE effective_record SET status = 'eaten'"))
