"""What monitoring is told of backups: how old the last one is, however much came after it, and what it lacks."""

from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.core.settings import Settings
from app.operations import figures
from app.operations.backup.last_backup import note_backup
from app.operations.figure_queries import last_backup
from app.operations.figures import DeploymentFigures
from app.people.privacy_models import AuditEvent
from app.storage.local import LocalBlobStore

DAY_SECONDS = 86_400
MANY_EVENTS = 60_000
NUMBERS = {
    "sqlite": "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < :count) SELECT {} FROM n",
    "postgres": "SELECT {} FROM generate_series(1, :count) AS i",
}


@pytest.fixture
def told(database, tmp_path, monkeypatch):
    """What a scrape tells, by the names of series."""
    monkeypatch.setattr(figures, "PATIENCE_SECONDS", 30.0)

    def tell():
        asked = DeploymentFigures(database, LocalBlobStore(tmp_path / "blobs"), Settings(data_dir=tmp_path))
        return {sample.name: sample.value for family in asked.collect() for sample in family.samples}

    return tell


def add_event(database, action, *, days_ago, **details):
    with database.write() as session:
        at = datetime.now(UTC) - timedelta(days=days_ago)
        session.add(AuditEvent(at=at, actor_kind="system", actor="system", action=action, details=details))


def add_many_events(database, kind):
    values = "'2026-11-20 12:00:00', 'system', 'system', 'session.open', '{}'"
    with database.write() as session:
        statement = "INSERT INTO audit_event (at, actor_kind, actor, action, details) " + NUMBERS[kind].format(values)
        session.execute(sa.text(statement.replace("'{}'", "CAST('{}' AS JSON)")), {"count": MANY_EVENTS})


def test_deployment_without_a_backup_is_as_old_as_its_first_event_and_blobs_that_one_lacks_are_told(database, told):
    assert told()["tada_backup_age_seconds"] == 0  # nothing has happened: there is nothing to lose
    add_event(database, "staff.create", days_ago=9)
    add_event(database, "staff.create", days_ago=1)
    found = told()
    assert found["tada_backup_age_seconds"] == pytest.approx(9 * DAY_SECONDS, abs=60)
    assert found["tada_backup_damaged_blobs"] == 0
    note_backup(database, blobs=7, damaged=2)
    assert told()["tada_backup_damaged_blobs"] == 2
    note_backup(database, blobs=9, damaged=0)
    found = told()
    assert found["tada_backup_damaged_blobs"] == 0
    assert found["tada_backup_age_seconds"] < 60


@pytest.mark.both_stores
def test_backup_behind_many_events_is_found_by_its_own_index(database, kind, told):
    add_event(database, "staff.create", days_ago=90)
    add_event(database, "backup.make", days_ago=30, blobs=5, damaged=0)
    add_many_events(database, kind)
    assert told()["tada_backup_age_seconds"] == pytest.approx(30 * DAY_SECONDS, abs=60)
    with database.write() as session:
        session.execute(sa.text("ANALYZE audit_event"))
    seen = []
    sa.event.listen(database.read_engine, "before_cursor_execute", lambda *call: seen.append(call[2:4]))
    with database.read() as session:
        last_backup(session)
        statement, parameters = seen[-1]
        explain = "EXPLAIN QUERY PLAN " if kind == "sqlite" else "EXPLAIN "
        plan = session.connection().exec_driver_sql(explain + statement, parameters).all()
    assert "ix_audit_event_last_backup" in str(plan)
