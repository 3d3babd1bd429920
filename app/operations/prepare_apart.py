"""Run `prepare` in a separate process: `python -m app.operations.prepare_apart PARENT_PID`.

A server would otherwise keep the memory that migrations and the starter food table need once (40
MB).
"""

import os
import signal
import subprocess
import sys

from app.core.errors import UnavailableError
from app.core.logs import configure_logging
from app.core.process_life import die_with_parent
from app.core.settings import Settings
from app.db.schema_state import MigrationBusyError, is_current
from app.db.session import Database, open_database
from app.foods.import_foods import is_starter_there
from app.jobs.supervisor import settings_environment
from app.operations.prepare import prepare

BUSY = 75  # exit status (EX_TEMPFAIL)


def prepare_apart(database: Database, settings: Settings) -> None:
    """Run the process if schema or starter table are not up to date.

    Most errors in it are not reported: the caller runs `prepare` afterwards, which raises the same
    error. Raises MigrationBusyError if another process was migrating for the whole patience, so
    that the caller need not wait again; UnavailableError if a signal ended the process (such as for
    lack of memory, which this process would then need and keep); OSError if it cannot be started;
    errors of the database.
    """
    if is_current(database) and is_starter_there(database):
        return
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
    completed = subprocess.run(
        [sys.executable, "-m", "app.operations.prepare_apart", str(os.getpid())],
        env=inherited | settings_environment(settings),
        stdin=subprocess.DEVNULL,
        check=False,
    )
    if completed.returncode == BUSY:
        raise MigrationBusyError(
            "Another process is migrating the database, or on SQLite writing to it, and did not end in time; nothing "
            "was changed. Wait for it to end (or end it, if it hangs), then try again."
        )
    if completed.returncode < 0:
        raise UnavailableError(
            f"The process that prepares the database was ended by signal {-completed.returncode} "
            f"({signal.strsignal(-completed.returncode)}): find the cause, such as a memory limit."
        )


def main(parent_pid: int) -> int:
    """Prepare; return exit status 1 on failure, BUSY if another process was migrating for the whole patience."""
    die_with_parent(parent_pid)
    settings = Settings()
    configure_logging(settings)
    database = open_database(settings)
    try:
        prepare(database, settings)
    except MigrationBusyError:
        return BUSY
    except Exception:  # noqa: BLE001  # the parent runs into it too, and reports it
        return 1
    finally:
        database.dispose()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1])))
