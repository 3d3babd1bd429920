"""Brings the schema up to date with Alembic, or back: `upgrade`, `downgrade`; tells whether it is: `is_current`.

The migrations lie in migrations/ of the checkout and inside the wheel as app/_migrations.
"""

from collections.abc import Callable
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from app.db.session import Database

LOCK_TIMEOUT_MS = 10_000  # PostgreSQL: a migration gives up rather than queue behind a long reader and block all others
ADVISORY_LOCK = 7_241_960_311  # one migrator at a time; the number has no meaning


def migrations_folder() -> Path:
    """The folder of migrations: in the wheel, else in the checkout."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "_migrations"
    return installed if installed.is_dir() else package.parent / "migrations"


def upgrade(database: Database, revision: str = "head") -> None:
    """Migrate up to `revision`, one migrator at a time: the others wait and then find nothing to do."""
    _migrate(database, command.upgrade, revision)


def downgrade(database: Database, revision: str) -> None:
    """Migrate down to `revision`; what the older schema cannot hold is lost, as its migration says."""
    _migrate(database, command.downgrade, revision)


def is_current(database: Database) -> bool:
    """Whether the schema is the one that this code was written for."""
    head = ScriptDirectory(str(migrations_folder())).get_current_head()
    with database.read_engine.connect() as connection:
        return _revision_of(connection) == head


def _migrate(database: Database, run: Callable[[Config, str], None], revision: str) -> None:
    with database.write_engine.connect() as connection:
        if database.is_sqlite:
            # It alters a table by making it anew, and dropping the old one would count as deleting its rows. Only
            # outside a transaction can this be set.
            _set_foreign_keys(connection, "OFF")
        else:
            connection.execute(sa.text("SELECT pg_advisory_lock(:n)"), {"n": ADVISORY_LOCK})
            connection.commit()
        try:
            with connection.begin():  # on SQLite BEGIN IMMEDIATE is the lock
                if not database.is_sqlite:
                    connection.execute(sa.text(f"SET LOCAL lock_timeout = {LOCK_TIMEOUT_MS}"))
                    connection.execute(sa.text("SET LOCAL statement_timeout = 0"))
                before = _revision_of(connection)
                run(_config(connection), revision)
                if database.is_sqlite and _revision_of(connection) != before:
                    _require_whole_references(connection)
        finally:
            if database.is_sqlite:
                _set_foreign_keys(connection, "ON")
            else:
                connection.execute(sa.text("SELECT pg_advisory_unlock(:n)"), {"n": ADVISORY_LOCK})
                connection.commit()


def _revision_of(connection: sa.Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()


def _set_foreign_keys(connection: sa.Connection, state: str) -> None:
    """On the driver's own connection: SQLAlchemy's would begin a transaction."""
    cursor = connection.connection.cursor()
    cursor.execute(f"PRAGMA foreign_keys = {state}")
    cursor.close()


def _require_whole_references(connection: sa.Connection) -> None:
    """Raises sa.exc.IntegrityError, before the commit, if a migration left a reference to a row that is not there."""
    broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    if broken:
        raise sa.exc.IntegrityError("PRAGMA foreign_key_check", None, ValueError(f"rows refer to none: {broken[:5]}"))


def _config(connection: sa.Connection) -> Config:
    config = Config()
    config.set_main_option("script_location", str(migrations_folder()))
    config.attributes["connection"] = connection
    return config
