"""On SQLite the threads of a process write one after the other, without asking the file again and again."""

import threading

import pytest
import sqlalchemy as sa

from app.db.session import Database
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction


@pytest.fixture
def counted(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'turns.sqlite3'}")
    with database.write() as session:
        session.execute(sa.text("CREATE TABLE counted (n INTEGER)"))
    yield database
    database.dispose()


def test_second_writer_waits_without_a_connection_and_writes_after_the_first(counted):
    done = threading.Event()

    def second():
        with counted.write() as session:
            session.execute(sa.text("INSERT INTO counted SELECT count(*) FROM counted"))
        done.set()

    thread = threading.Thread(target=second)
    with counted.write() as session:
        session.execute(sa.text("INSERT INTO counted VALUES (-1)"))
        thread.start()
        wait_for_blocked_transaction(counted)
        assert not done.is_set()
        assert counted.write_engine.pool.checkedout() == 1
    thread.join(PATIENCE_SECONDS)
    with counted.read() as session:
        assert list(session.scalars(sa.text("SELECT n FROM counted"))) == [-1, 1]


def test_turn_is_given_back_by_a_transaction_that_fails(counted):
    with pytest.raises(ZeroDivisionError), counted.write():
        raise ZeroDivisionError
    with counted.write() as session:
        session.execute(sa.text("INSERT INTO counted VALUES (1)"))
