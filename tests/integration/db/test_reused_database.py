"""The tests' own tool: a database that is used again is as it was made."""

import contextlib
import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.db.session import Database
from app.foods.models import Food
from app.people.access.staff import create_admin
from app.people.models import Staff, Study


@pytest.fixture
def used(postgres_prepared):
    """A database taken, changed by what is given, and given back; then the next one that is taken: is it the same?"""

    @contextlib.contextmanager
    def then(change):
        with postgres_prepared.one() as first:
            database = Database(first)
            change(database)
            database.dispose()
        with postgres_prepared.one() as second:
            database = Database(second)
            yield first == second, database
            database.dispose()

    return then


def add_study(database):
    with database.write() as session:
        now = datetime.now(UTC)
        session.add(Study(id=uuid.uuid4(), code="left", name="Left", created_at=now, location_policy="drop"))


def count(database, table):
    with database.read() as session:
        return session.scalar(sa.select(sa.func.count()).select_from(table))


def test_what_a_test_wrote_is_gone_in_the_next(used):
    def change(database):
        add_study(database)
        create_admin(database, "left")  # it is noted in the audit log, which refuses to be emptied

    with used(change) as (is_same, database):
        assert is_same
        assert count(database, Study) == count(database, Staff) == 0


def test_foods_that_a_test_changed_and_tables_that_it_made_or_altered_are_not_used_again(used):
    for statement in (
        "UPDATE food SET name = 'Changed' WHERE key = 'apple'",
        "CREATE TABLE left_over (a integer)",
        "ALTER TABLE study ADD COLUMN left_over integer",
    ):

        def change(database, statement=statement):
            with database.write() as session:
                session.execute(sa.text(statement))

        with used(change) as (is_same, database), database.read() as session:
            assert not is_same
            assert session.scalars(sa.select(Food.name).where(Food.key == "apple")).one() != "Changed"


def test_database_that_somebody_still_uses_is_not_used_again(used):
    held = []

    def change(database):
        held.append(sa.create_engine(database.write_engine.url, poolclass=sa.NullPool).connect())

    with used(change) as (is_same, _):
        assert not is_same
    for connection in held:
        connection.invalidate()
