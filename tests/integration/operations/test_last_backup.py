"""What monitoring is told of backups: how old the last one is, however much came after it, and what it lacks."""

from datetime import UTC, datetime, timedelta

import pytest

from app.core.settings import Settings
from app.operations import figures
from app.operations.backup.write_backup import note_backup
from app.operations.figures import DeploymentFigures
from app.people.privacy_models import AuditEvent
from app.storage.local import LocalBlobStore

DAY_SECONDS = 86_400


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


def test_deployment_without_a_backup_is_as_old_as_its_first_event_and_blobs_that_one_lacks_are_told(database, told):
    assert told()["tada_backup_age_seconds"] == 0  # nothing has happened: there is nothing to lose
    add_event(database, "staff.create", days_ago=9)
    add_event(database, "staff.create", days_ago=1)
    found = told()
    assert found["tada_backup_age_seconds"] == pytest.approx(9 * DAY_SECONDS, abs=60)
    assert found["tada_backup_damaged_blobs"] == 0
    add_event(database, "backup.make", days_ago=3, blobs=5, damaged=0)
    assert told()["tada_backup_age_seconds"] == pytest.approx(3 * DAY_SECONDS, abs=60)
    note_backup(database, blobs=7, damaged=2)
    assert told()["tada_backup_damaged_blobs"] == 2
    note_backup(database, blobs=9, damaged=0)
    found = told()
    assert found["tada_backup_damaged_blobs"] == 0
    assert found["tada_backup_age_seconds"] < 60
