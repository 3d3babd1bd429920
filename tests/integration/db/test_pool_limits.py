"""A process takes no more connections than it may, and says so with 503 while all are taken."""

import contextlib

import pytest
import sqlalchemy as sa

from app.core.settings import Settings
from app.db.session import PoolLimits, open_database
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair


@pytest.fixture
def settings(settings, monkeypatch):
    """Of the whole API: two connections, and hardly any patience."""
    monkeypatch.setattr("app.db.session.POOL_WAIT_SECONDS", 0.2)
    return settings.model_copy(update={"database_pool_size": 1, "database_pool_overflow": 1})


def taken(state, engine):
    """All connections of an engine, until the block ends."""
    held = contextlib.ExitStack()
    for _ in range(2):
        held.enter_context(engine.connect())
    with pytest.raises(sa.exc.TimeoutError):
        engine.connect()
    return held


def test_no_free_connection_is_503_with_retry_after_and_the_next_call_is_served(phone, state):
    calls = (lambda: phone.get("/v1/records"), lambda: phone.post(pair(), meal_metadata()))
    held = taken(state, state.database.write_engine)
    if state.database.is_sqlite:
        held.enter_context(taken(state, state.database.read_engine))
    with held:
        answers = [call() for call in calls]
    for answer in answers:
        assert (answer.status_code, answer.json()["code"], answer.json()["retryable"]) == (503, "unavailable", True)
        assert int(answer.headers["Retry-After"]) > 0
    assert [call().status_code for call in calls] == [200, 202]


@pytest.mark.both_stores
def test_limits_of_the_settings_are_those_of_the_server(database_url, kind):
    settings = Settings(
        database_url=database_url,
        database_pool_size=3,
        database_pool_overflow=2,
        database_statement_seconds=0.2,
    )
    database = open_database(settings)
    try:
        assert database.limits == PoolLimits(3, 2, 0.2)
        pool = database.write_engine.pool
        assert (pool.size(), pool._max_overflow) == (3, 2)
        if kind == "postgres":
            assert pool._recycle == 1800
            with pytest.raises(sa.exc.OperationalError, match="statement timeout"), database.read() as session:
                session.execute(sa.text("SELECT pg_sleep(30)"))
    finally:
        database.dispose()
