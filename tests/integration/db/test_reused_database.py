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


def test_what_a_test_wrote_is_gone_in_the_next(used):
    def change(database):
        add_study(database)
        create_admin(database, "left")  # it is noted in the audit log, which refuses to be emptied

    with used(change) as (is_same, database), database.read() as session:
        assert is_same
        for table in (Study, Staff):
            assert session.scalars(sa.select(table)).all() == []


def test_database_with_other_foods_or_tables_or_that_somebody_still_uses_is_not_used_again(used):
    held = []

    def hold(database):
        held.append(sa.create_engine(database.write_engine.url, poolclass=sa.NullPool).connect())

    with used(hold) as (is_same, _):
        assert not is_same
    held[0].invalidate()
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
