"""A process that starts before its database waits for it a while; one that is set up wrong does not."""

from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.db.session import Database
from app.operations import prepare as module
from app.operations.prepare import prepare_patiently


@pytest.fixture
def away(monkeypatch):
    """How often the database does not answer yet, and the waits between the attempts, which alone move the clock."""
    found = SimpleNamespace(left=0, waits=[])
    clock = SimpleNamespace(monotonic=lambda: sum(found.waits), sleep=found.waits.append)
    monkeypatch.setattr(module, "time", clock)

    def answer(_database):
        if found.left:
            found.left -= 1
            raise sa.exc.OperationalError("SELECT", {}, Exception("the database system is starting up"))

    monkeypatch.setattr(module, "upgrade_schema", answer)
    return found


@pytest.fixture
def database(prepared_database_url):
    database = Database(prepared_database_url)
    yield database
    database.dispose()


def test_database_that_answers_later_is_waited_for_less_and_less_often(database, tmp_path, away):
    away.left = 6
    prepare_patiently(database, Settings(data_dir=tmp_path))
    assert away.waits == pytest.approx([0.2, 0.4, 0.8, 1.6, 2.0, 2.0])


def test_patience_that_is_over_raises_what_the_database_said(database, tmp_path, away):
    away.left = 100
    with pytest.raises(sa.exc.OperationalError, match="starting up"):
        prepare_patiently(database, Settings(data_dir=tmp_path), patience_seconds=1.0)
    assert away.waits == pytest.approx([0.2, 0.4])


def test_settings_that_are_wrong_are_told_at_once(database, tmp_path, away):
    with pytest.raises(InvalidInputError):
        prepare_patiently(database, Settings(data_dir=tmp_path, erasure_url="nonsense://here"))
    assert away.waits == []
