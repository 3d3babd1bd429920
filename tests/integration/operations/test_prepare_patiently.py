"""A process that starts before its database waits for it a while; one that is set up wrong does not."""

import pytest
import sqlalchemy as sa

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.db.schema_state import is_current
from app.db.session import Database
from app.operations import prepare as module
from app.operations.prepare import prepare_patiently


@pytest.fixture
def away(monkeypatch):
    """How often the database does not answer yet, and what it says then."""
    found = {"left": 0, "asked": 0}
    upgrade = module.upgrade_schema

    def answer(database):
        found["asked"] += 1
        if found["left"]:
            found["left"] -= 1
            raise sa.exc.OperationalError("SELECT", {}, Exception("the database system is starting up"))
        upgrade(database)

    monkeypatch.setattr(module, "upgrade_schema", answer)
    return found


def test_database_that_answers_at_the_third_try_is_prepared(database_url, tmp_path, away):
    away["left"] = 2
    database = Database(database_url)
    prepare_patiently(database, Settings(data_dir=tmp_path))
    assert away["asked"] == 3
    assert is_current(database)
    database.dispose()


def test_patience_that_is_over_raises_what_the_database_said(database_url, tmp_path, away):
    away["left"] = 100
    database = Database(database_url)
    with pytest.raises(sa.exc.OperationalError, match="starting up"):
        prepare_patiently(database, Settings(data_dir=tmp_path), patience_seconds=0.5)
    assert away["asked"] > 1
    database.dispose()


def test_settings_that_are_wrong_are_told_at_once(database_url, tmp_path, away):
    database = Database(database_url)
    with pytest.raises(InvalidInputError):
        prepare_patiently(database, Settings(data_dir=tmp_path, erasure_url="nonsense://here"))
    assert away["asked"] == 1
    database.dispose()
