"""What keeps a server, a worker or a command from beginning is one sentence with a status, and no traceback."""

import errno
import functools
import json
import os
import sqlite3
import subprocess
import sys

import pytest
import sqlalchemy as sa

import app.cli.serving
import app.main
import app.worker
from app.cli.serving import serve
from app.core.errors import StorageFullError, TadaError, UnavailableError
from app.core.settings import Settings
from app.db.session import Database
from app.operations.doctor.doctor import examine
from app.operations.explain_errors import explain_error, explained_errors
from app.operations.prepare import prepare, prepare_patiently
from app.people.access.secret_box import SecretKeyError
from app.storage import s3
from app.worker import run_worker
from tests.conftest import postgres_database
from tests.integration.operations.weak_role import weak_role
from tests.support.s3_places import IMPATIENT
from tests.support.waiting import PATIENCE_SECONDS

KEY = "a key for tests only, of no worth"


@pytest.fixture
def impatient(monkeypatch):
    """Servers and workers in the test's own process, which wait a moment only and leave its logging alone."""
    hasty = functools.partial(prepare_patiently, patience_seconds=0.1)
    for module in (app.main, app.worker):
        monkeypatch.setattr(module, "prepare_patiently", hasty)
    for module in (app.cli.serving, app.worker):
        monkeypatch.setattr(module, "configure_logging", lambda _: None)
    monkeypatch.setattr(s3, "PATIENCE", IMPATIENT)


@pytest.fixture
def weak(postgres_server):
    """A role that may connect to a database of somebody else's, and no more: its URL, and the owner's database."""
    with postgres_database(postgres_server) as url, weak_role(url) as found:
        yield found


def begun(*command, **variables):
    """A process that is to end by itself: how it ended."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
    return subprocess.run(
        [sys.executable, "-m", *command],
        env=environment | {name: str(value) for name, value in variables.items()},
        capture_output=True,
        text=True,
        check=False,
        timeout=10 * PATIENCE_SECONDS,
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", [("app.cli", "serve"), ("app.worker",)])
def test_role_without_rights_is_told_in_a_sentence_by_processes(weak, tmp_path, command):
    url, _ = weak
    place = {"TADA_DATABASE_URL": url, "TADA_DATA_DIR": tmp_path, "TADA_SECRET_KEY": KEY, "TADA_PORT": 0}
    ended = begun(*command, **place)
    assert ended.returncode == 2, ended.stderr
    assert "Traceback" not in ended.stderr
    *log, told = ended.stderr.splitlines()
    assert told.startswith("tada: The database denies permission: permission denied for schema public")
    assert all(json.loads(line) for line in log)


def test_ledger_that_is_away_is_told_by_server_and_worker(prepared_database_url, tmp_path, impatient, caplog):
    """The photographs' store may be away, the ledger may not: who was erased must not be served."""
    (tmp_path / "file").touch()
    settings = Settings(
        database_url=prepared_database_url,
        data_dir=tmp_path / "data",
        secret_key=KEY,
        erasure_url="s3://ledger/of-erasures",
        s3_endpoint="http://127.0.0.1:1",
        s3_access_key_id="a",
        s3_secret_access_key="b",
        port=0,
    )
    for begin in (functools.partial(serve, with_worker=False), run_worker):
        with pytest.raises(TadaError, match=r"^s3://ledger/of-erasures at \S+: the file store cannot be reached"):
            begin(settings)
    assert "Traceback" not in caplog.text


@pytest.mark.both_stores
def test_another_key_than_the_databases_is_told_by_server_worker_and_doctor(
    prepared_database_url, blob_settings, tmp_path, impatient
):
    """With it erased meals would not be recognised."""
    place = {"database_url": prepared_database_url, "data_dir": tmp_path, "port": 0, **blob_settings}
    first, other = (Settings(secret_key=key, **place) for key in (KEY, "another key, by mistake or after a loss"))
    database = Database(prepared_database_url)
    try:
        prepare(database, first)
        for begin in (functools.partial(serve, with_worker=False), run_worker):
            with pytest.raises(SecretKeyError, match="is not the key that this database was first used with"):
                begin(other)
        prepare(database, first)
        right, wrong = (
            {each.subject for each in examine(database, settings, requeue=False) if each.level == "bad"}
            for settings in (first, other)
        )
    finally:
        database.dispose()
    assert "secret key of the database" in wrong - right


def test_database_that_is_away_is_told_by_server_and_worker(tmp_path, impatient, caplog):
    settings = Settings(database_url="postgresql://nobody@127.0.0.1:1/none", data_dir=tmp_path, secret_key=KEY, port=0)
    for begin in (functools.partial(serve, with_worker=False), run_worker):
        with pytest.raises(UnavailableError, match=r"The database does not answer: .*127\.0\.0\.1"):
            begin(settings)
    assert "Traceback" not in caplog.text


def test_file_that_is_no_database_is_told(tmp_path, impatient):
    (tmp_path / "tada.sqlite3").write_bytes(b"no database at all" * 1000)
    with pytest.raises(UnavailableError, match="damaged, or not ours: file is not a database"):
        run_worker(Settings(data_dir=tmp_path))


def test_fault_of_a_worker_that_works_keeps_its_traceback(prepared_database_url, tmp_path, impatient, monkeypatch):
    settings = Settings(database_url=prepared_database_url, data_dir=tmp_path, secret_key=KEY)

    def begin_and_fail(_, __, *, at_start, is_at_work, **___):
        with at_start():
            if not is_at_work:
                raise OSError(errno.EACCES, "Permission denied")
        raise OSError(errno.EBADF, "Bad file descriptor")

    monkeypatch.setattr(app.worker, "run_jobs", functools.partial(begin_and_fail, is_at_work=True))
    with pytest.raises(OSError, match="Bad file descriptor"):
        run_worker(settings)
    monkeypatch.setattr(app.worker, "run_jobs", functools.partial(begin_and_fail, is_at_work=False))
    with pytest.raises(UnavailableError, match="Permission denied"):
        run_worker(settings)


def test_statement_that_sqlite_does_not_take_is_a_fault_of_the_program():
    """sqlite3 raises the class that it has for a database that is locked or away."""
    connection = sqlite3.connect(":memory:")
    with pytest.raises(sqlite3.OperationalError) as caught:
        connection.execute("SELECT 1 FROM nowhere")
    connection.close()
    assert explain_error(caught.value) is None
    assert explain_error(sa.exc.OperationalError("SELECT 1 FROM nowhere", {}, caught.value)) is None
    with pytest.raises(sqlite3.OperationalError) as caught:
        sqlite3.connect("/nowhere/at/all")
    assert explain_error(caught.value).message.startswith("The database does not answer: unable to open")


def test_what_is_wrapped_is_told_by_its_cause_and_what_is_ours_is_not():
    away = sa.exc.OperationalError("SELECT 1", {}, Exception("the database system is starting up"))
    wrapped = RuntimeError("it did not begin")
    wrapped.__cause__ = away
    assert explain_error(wrapped).message == "The database does not answer: the database system is starting up"
    full = sqlite3.OperationalError("database or disk is full")
    full.sqlite_errorcode = sqlite3.SQLITE_FULL
    assert "TMPDIR" in explain_error(full).message  # a scratch file's, which no engine of SQLAlchemy wraps
    assert isinstance(explain_error(OSError(28, "No space left on device", "/data")), StorageFullError)
    assert explain_error(sa.exc.ProgrammingError("SELEC", {}, Exception("syntax error"))) is None
    with pytest.raises(KeyError), explained_errors():
        raise KeyError("x")
