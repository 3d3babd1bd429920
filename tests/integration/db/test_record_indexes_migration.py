"""The indexes of records: made beforehand, or by the migration, which makes one anew that is unfinished.

And what the migrations that make them wait for.
"""

import pytest
import sqlalchemy as sa

from app.db.migrate import Patience, downgrade, upgrade
from app.db.session import Database

BEFORE = "20261122_fair_turns"
NAME = "ix_effective_record_study_id_status_captured_at_item_id"
FORMER_OF_QUEUE = "ix_effective_record_study_id_reviewed_doubt_item_id"
BEFOREHAND = f"CREATE INDEX {NAME} ON effective_record (study_id, status, captured_at, item_id)"


@pytest.fixture
def older(database_url):
    database = Database(database_url)
    upgrade(database, BEFORE)
    yield database
    database.dispose()


def names(database):
    return {index["name"] for index in sa.inspect(database.write_engine).get_indexes("effective_record")}


def test_index_that_was_made_beforehand_is_kept(older):
    with older.write() as session:
        session.execute(sa.text(BEFOREHAND))
    upgrade(older)
    assert NAME in names(older)
    downgrade(older, BEFORE)
    assert NAME not in names(older)


def test_unfinished_index_is_made_anew(older):
    if older.is_sqlite:
        return  # it has none that are unfinished
    with older.write() as session:
        session.execute(sa.text(BEFOREHAND))
        session.execute(
            sa.text("UPDATE pg_index SET indisvalid = false WHERE indexrelid = to_regclass(:n)"), {"n": NAME}
        )
    upgrade(older)
    with older.read() as session:
        valid = session.execute(
            sa.text("SELECT indisvalid FROM pg_index WHERE indexrelid = to_regclass(:n)"), {"n": NAME}
        )
        assert valid.scalar_one() is True


def test_queue_of_older_servers_keeps_its_index(older):
    assert FORMER_OF_QUEUE in names(older)
    upgrade(older)
    assert FORMER_OF_QUEUE in names(older)
    downgrade(older, BEFORE)
    assert FORMER_OF_QUEUE in names(older)


def test_indexes_are_made_while_a_worker_has_read_records_and_comes_to_write_them(older):
    """Dropping one would wait for the worker; it has built others by then, for which the worker waits: a deadlock."""
    if older.is_sqlite:
        return  # who comes to write has no transaction before its turn
    with older.write() as worker:
        worker.execute(sa.text("SELECT * FROM effective_record"))
        upgrade(older, patience=Patience(lock_seconds=1.0, tries=1))
        worker.execute(sa.text("UPDATE effective_record SET doubt = doubt"))
    assert "ix_effective_record_queue_of_food" in names(older)
