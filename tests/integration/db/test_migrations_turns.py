"""Who migrates, waits, gives up or dies: one at a time, nothing without end, and the old schema or the new one."""

import os
import signal
import subprocess
import sys
import threading

import pytest
import sqlalchemy as sa

from app.core.settings import Settings
from app.db.migrate import ADVISORY_LOCK, MigrationBlockedError, Patience, SchemaUnknownError, downgrade, upgrade
from app.db.schema_state import (
    MigrationBusyError,
    SchemaState,
    current_revision,
    head_revision,
    is_current,
    revisions,
    schema_state,
)
from app.db.session import Database
from app.operations.health_api import check_readiness
from app.storage.opening import open_blob_store
from tests.support.commands import run_tada

pytestmark = pytest.mark.slow

BASELINE = head_revision()
HASTY = Patience(turn_seconds=0.3, lock_seconds=0.2, tries=2, pause_seconds=0.05)
# A migrator that ends in the middle: at its third CREATE, or while the database is busy with one statement of its own
MIGRATOR = """
import os, signal, sys, threading
import sqlalchemy as sa
from app.db.migrate import Patience, upgrade
from app.db.session import Database

database, how, seen = Database(sys.argv[1]), sys.argv[2], []

@sa.event.listens_for(database.write_engine, "before_cursor_execute", retval=True)
def before(connection, cursor, statement, parameters, context, executemany):
    if "CREATE TABLE" in statement:
        seen.append(statement)
    if len(seen) == 3:
        if how == "between":
            os.kill(os.getpid(), signal.SIGKILL)
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGKILL)).start()
        return "SELECT pg_sleep(600)", ()
    return statement, parameters

upgrade(database, patience=Patience(lock_seconds=0.5))
"""


@pytest.fixture
def empty(database_url):
    database = Database(database_url)
    yield database
    database.dispose()


def start(*arguments):
    return subprocess.Popen([sys.executable, *arguments], stderr=subprocess.PIPE, text=True, env=os.environ)


@pytest.mark.both_stores
def test_two_processes_that_migrate_at_once_both_end_well(empty):
    code = "import sys, app.db.migrate as m, app.db.session as s; m.upgrade(s.Database(sys.argv[1]))"
    both = [start("-c", code, empty.url) for _ in range(2)]
    ended = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], ended
    assert is_current(empty)


@pytest.mark.both_stores
def test_migrator_killed_in_the_middle_leaves_the_old_schema_and_no_lock(empty):
    killed = start("-c", MIGRATOR, empty.url, "between")
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    assert current_revision(empty) is None
    upgrade(empty, patience=Patience(turn_seconds=5))
    assert is_current(empty)


@pytest.mark.parametrize("kind", ["postgres"])  # SQLite's statements end with their process
def test_lock_of_a_migrator_killed_during_a_long_statement_is_free_within_seconds(empty):
    killed = start("-c", MIGRATOR, empty.url, "during")
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    assert current_revision(empty) is None
    upgrade(empty, patience=Patience(turn_seconds=10))  # and not after the statement's ten minutes
    assert is_current(empty)


@pytest.mark.both_stores
def test_migrator_gives_up_when_another_one_does_not_end(database, next_migration):
    next_migration()
    with database.write_engine.connect() as other:
        if not database.is_sqlite:  # of a session, as versions before 0.2 took it
            other.execute(sa.text("SELECT pg_advisory_lock(:n)"), {"n": ADVISORY_LOCK})
        else:
            other.begin()
        with pytest.raises(MigrationBusyError, match=r"for more than 0 s"):
            upgrade(database, patience=HASTY)
        other.rollback()
        if not database.is_sqlite:
            other.execute(sa.text("SELECT pg_advisory_unlock(:n)"), {"n": ADVISORY_LOCK})
    assert current_revision(database) == BASELINE
    upgrade(database, patience=HASTY)
    assert is_current(database)


@pytest.mark.parametrize("kind", ["postgres"])  # on SQLite a reader has its snapshot and holds nobody up
def test_table_in_use_without_pause_ends_the_migration_and_blocks_nobody_and_once_free_it_is_migrated(database):
    with database.write_engine.connect() as reader:
        reader.execute(sa.text("SELECT count(*) FROM effective_record, job, meal"))  # and stays open
        with pytest.raises(MigrationBlockedError, match="2 attempts"):
            downgrade(database, "base", patience=HASTY)
        with database.read() as session:  # the table's queue is empty again
            session.execute(sa.text("SELECT count(*) FROM job"))
        assert is_current(database)
        leave = threading.Timer(0.4, reader.rollback)  # between two tries
        leave.start()
        downgrade(database, "base", patience=Patience(lock_seconds=0.2, tries=30, pause_seconds=0.05))
        leave.join()
    assert current_revision(database) is None


@pytest.mark.both_stores
def test_code_is_ready_beside_a_newer_schema_and_not_on_an_older_one_and_refuses_one_it_does_not_know(
    database, tmp_path, next_migration
):
    settings = Settings(data_dir=tmp_path / "data", min_free_bytes=0)
    blobs = open_blob_store(settings.resolved_blob_url, settings)

    def set_revision(name):
        with database.write_engine.begin() as connection:
            connection.execute(sa.text("UPDATE alembic_version SET version_num = :name"), {"name": name})

    set_revision("20991231_of_the_future")
    assert schema_state(database) is SchemaState.NEWER
    upgrade(database)
    assert current_revision(database) == "20991231_of_the_future"
    assert check_readiness(database, blobs, settings).checks["database"] == "ok"
    with pytest.raises(SchemaUnknownError, match="newer program"):
        downgrade(database, BASELINE)
    set_revision("20261123_spent_codes")
    assert schema_state(database) is SchemaState.OLDER
    with pytest.raises(SchemaUnknownError, match=r"before 0\.4"):
        upgrade(database)
    set_revision(BASELINE)
    next_migration()
    assert schema_state(database) is SchemaState.OLDER
    assert "tada db upgrade" in check_readiness(database, blobs, settings).checks["database"]


def test_commands_tell_how_the_schema_stands_and_bring_it_up_to_a_revision(empty):
    told = run_tada("db", "current", TADA_DATABASE_URL=empty.url)
    assert (told.returncode, told.stdout) == (1, f"none: older; this program was written for {head_revision()}\n")
    done = run_tada("db", "upgrade", "--revision", revisions()[0], TADA_DATABASE_URL=empty.url)
    assert done.returncode == 0, done.stderr
    assert current_revision(empty) == revisions()[0]
    wrong = run_tada("db", "upgrade", "--revision", "nonsense", TADA_DATABASE_URL=empty.url)
    assert (wrong.returncode, "no revision 'nonsense'" in wrong.stderr) == (2, True)
