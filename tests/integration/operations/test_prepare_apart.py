"""Migrations and the starter table take memory once: not that of the process that serves."""

import signal
import subprocess

import pytest
import sqlalchemy as sa

from app.core.errors import UnavailableError
from app.core.settings import Settings
from app.db.schema_state import MigrationBusyError, is_current
from app.db.session import Database
from app.foods.import_foods import is_starter_there
from app.jobs.supervisor import settings_environment
from app.operations import prepare as prepare_module
from app.operations import prepare_apart as module
from app.operations.prepare import prepare_patiently
from app.operations.prepare_apart import prepare_apart

pytestmark = pytest.mark.slow


@pytest.fixture
def empty(database_url, tmp_path):
    """An empty database and its settings."""
    database = Database(database_url)
    yield database, Settings(data_dir=tmp_path, database_url=database_url, secret_key="k" * 40)
    database.dispose()


def test_an_empty_database_is_made_ready_by_another_process(empty, monkeypatch):
    monkeypatch.setattr(module, "prepare", None)  # not by this one
    prepare_apart(*empty)
    assert is_current(empty[0])
    assert is_starter_there(empty[0])


def test_no_process_is_started_where_all_is_there(prepared_database_url, tmp_path, monkeypatch):
    monkeypatch.setattr(module.subprocess, "run", None)
    database = Database(prepared_database_url)
    prepare_apart(database, Settings(data_dir=tmp_path, database_url=prepared_database_url))
    with database.write() as session:
        session.execute(sa.text("UPDATE food_release SET checksum = 'another version'"))
    assert not is_starter_there(database)
    database.dispose()


def test_what_goes_wrong_there_is_left_to_who_prepares_next(empty, capfd):
    database, settings = empty
    prepare_apart(database, settings.model_copy(update={"erasure_url": "nonsense://here"}))
    assert "Traceback" not in capfd.readouterr().err
    assert is_current(database)  # as far as it came


class Ended:
    """In the place of subprocess.run: processes that end so. It counts them."""

    def __init__(self, status):
        self.status, self.count = status, 0

    def __call__(self, command, **_):
        self.count += 1
        return subprocess.CompletedProcess(command, self.status)


def test_process_that_a_signal_ended_is_told_and_its_work_not_done_here(empty, monkeypatch):
    ended = Ended(-signal.SIGKILL)
    monkeypatch.setattr(module.subprocess, "run", ended)
    monkeypatch.setattr(prepare_module, "prepare", None)
    with pytest.raises(UnavailableError, match=r"ended by signal 9 \(Killed\)") as caught:
        prepare_patiently(*empty, patience_seconds=1.0, first=prepare_apart)
    assert caught.value.retryable
    assert ended.count > 1  # the next one may have more memory


@pytest.mark.both_stores
def test_process_that_found_others_busy_for_the_whole_patience_is_not_waited_for_twice(empty, monkeypatch):
    ended = Ended(module.BUSY)
    monkeypatch.setattr(module.subprocess, "run", ended)
    monkeypatch.setattr(prepare_module, "prepare", None)
    with pytest.raises(MigrationBusyError, match="did not end in time"):
        prepare_patiently(*empty, patience_seconds=0.0, first=prepare_apart)
    assert ended.count == 1


@pytest.mark.both_stores
def test_status_of_a_process_tells_whether_others_were_busy(empty, monkeypatch):
    _, settings = empty
    for name, value in settings_environment(settings).items():
        monkeypatch.setenv(name, value)
    for name in ("die_with_parent", "configure_logging"):
        monkeypatch.setattr(module, name, lambda _: None)
    for error, status in ((MigrationBusyError("busy"), module.BUSY), (UnavailableError("away"), 1)):

        def fail(*_, error=error):
            raise error

        monkeypatch.setattr(module, "prepare", fail)
        assert module.main(1) == status
