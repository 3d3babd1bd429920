"""What processes read of a schema's state is what Alembic would tell; what sessions of the database may do."""

import pytest
import sqlalchemy as sa
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from app.db.migrate import upgrade
from app.db.schema_state import current_revision, is_current, migrations_folder, revisions
from app.db.session import Database

INSERT = sa.text("INSERT INTO component (number, name, unit) VALUES ('X', 'x', 'g')")


@pytest.mark.both_stores
def test_revision_of_a_database_is_alembic_s_none_before_the_first_and_upgrading_twice_changes_nothing(database_url):
    scripts = ScriptDirectory(str(migrations_folder())).walk_revisions("base", "heads")
    assert list(revisions()) == [script.revision for script in reversed(list(scripts))]
    database = Database(database_url)
    try:
        assert (is_current(database), current_revision(database)) == (False, None)
        for revision in (revisions()[0], "head", "head"):
            upgrade(database, revision)
            with database.read_engine.connect() as connection:
                told = MigrationContext.configure(connection).get_current_revision()
            assert current_revision(database) == told is not None
            assert is_current(database) is (revision == "head")
    finally:
        database.dispose()


@pytest.mark.both_stores
def test_read_session_cannot_write_and_a_failed_transaction_leaves_nothing(database):
    with database.read() as session:
        with pytest.raises(sa.exc.DBAPIError):
            session.execute(INSERT)
        session.rollback()
    with pytest.raises(ZeroDivisionError), database.write() as session:  # noqa: PT012
        session.execute(INSERT)
        raise ZeroDivisionError
    with database.read() as session:
        assert session.execute(sa.text("SELECT count(*) FROM component")).scalar_one() == 0
