"""What processes that serve read by themselves is what Alembic would tell."""

import pytest
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from app.db.migrate import upgrade
from app.db.schema_state import current_revision, migrations_folder, revisions
from app.db.session import Database


@pytest.fixture
def database(database_url):
    opened = Database(database_url)
    yield opened
    opened.dispose()


def test_revisions_are_alembics_in_its_order():
    scripts = ScriptDirectory(str(migrations_folder())).walk_revisions("base", "heads")
    assert list(revisions()) == [script.revision for script in reversed(list(scripts))]


@pytest.mark.both_stores
def test_an_empty_database_has_no_revision(database):
    assert current_revision(database) is None


@pytest.mark.parametrize("revision", [revisions()[0], "head"])
def test_revision_of_a_database_is_alembics(database, revision):
    upgrade(database, revision)
    with database.read_engine.connect() as connection:
        assert current_revision(database) == MigrationContext.configure(connection).get_current_revision() is not None
