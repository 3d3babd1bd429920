"""The schema that migrations make is the one that the models describe, in all that the database itself tells."""

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from app.db.base import Base
from app.db.session import Database
from tests.integration.db.schema_facts import facts_of


@pytest.fixture
def made_by_models(database_url, tmp_path, kind):
    """A database that no migration has touched."""
    other = Database(f"sqlite:///{tmp_path / 'models.sqlite3'}" if kind == "sqlite" else database_url)
    with other.write_engine.begin() as connection:
        Base.metadata.create_all(connection)
    yield other
    other.dispose()


def facts(database):
    with database.read_engine.connect() as connection:
        return facts_of(connection)


@pytest.mark.both_stores
def test_migrated_schema_equals_the_models_fact_by_fact_and_for_alembic(database, made_by_models):
    migrated, models = facts(database), facts(made_by_models)
    assert len({table for table, _, _ in models}) == len(Base.metadata.tables)
    assert {what for _, what, _ in models} == {"column", "constraint", "index"}
    differing = {key: (migrated.get(key, ""), text) for key, text in models.items() if migrated.get(key) != text}
    assert {key: both for key, both in differing.items() if not is_default_for_older_code(*both)} == {}
    assert migrated.keys() - models.keys() == set()
    options = {
        "compare_type": True,
        "include_name": lambda name, kind, _: kind != "table" or name in Base.metadata.tables,
    }
    with database.read_engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection, opts=options), Base.metadata) == []


def is_default_for_older_code(migrated, model):
    """A column that was added keeps its default in the schema, for processes that do not know the column yet."""
    return " not null default " in migrated and migrated.partition(" default ")[0] == model
