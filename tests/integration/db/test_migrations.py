import pytest
import sqlalchemy as sa

from app.db.migrate import upgrade
from app.db.schema_state import is_current
from app.db.session import Database


@pytest.mark.both_stores
def test_upgrading_twice_changes_nothing(database):
    assert is_current(database)
    upgrade(database)
    assert is_current(database)


@pytest.mark.both_stores
def test_empty_database_is_not_current(database_url):
    database = Database(database_url)
    try:
        assert not is_current(database)
    finally:
        database.dispose()


@pytest.mark.both_stores
def test_write_in_a_read_session_is_refused_by_the_database(database):
    with database.read() as session:
        try:
            session.execute(sa.text("INSERT INTO component (number, name, unit) VALUES ('X', 'x', 'g')"))
        except sa.exc.DBAPIError:
            session.rollback()
        else:
            raise AssertionError("a read session could write")


@pytest.mark.both_stores
def test_failed_transaction_leaves_nothing(database):
    class Stop(Exception):  # noqa: N818
        pass

    try:
        with database.write() as session:
            session.execute(sa.text("INSERT INTO component (number, name, unit) VALUES ('X', 'x', 'g')"))
            raise Stop
    except Stop:
        pass
    with database.read() as session:
        assert session.execute(sa.text("SELECT count(*) FROM component")).scalar_one() == 0
