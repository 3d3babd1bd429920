"""What `prepare` has to make, made in a process of its own: `python -m app.operations.prepare_apart PARENT_PID`.

A process that serves for months would keep the memory that migrations and the starter food table take once (40 MB).
"""

import os
import signal
import subprocess
import sys

from app.children.process_life import die_with_parent
from app.core.errors import UnavailableError
from app.core.logs import configure_logging
from app.core.settings import Settings
from app.db.schema_state import MigrationBusyError, is_current
from app.db.session import Database, open_database
from app.foods.import_foods import is_starter_there
from app.jobs.supervisor import settings_environment
from app.operations.prepare import prepare

BUSY = 75  # exit status (EX_TEMPFAIL)


def prepare_apart(database: Database, settings: Settings) -> None:
    """Have it made if anything is missing.

    Most of what goes wrong there is not told: the caller prepares afterwards, finds the same and tells it. Raises
    MigrationBusyError where another process was at it for the whole patience, which the caller need not wait for again;
    UnavailableError where the process was ended by a signal (such as for want of memory, which this one would take and
    keep); OSError where none can be started; what the database raises when it is asked what it has.
    """
    if is_current(database) and is_starter_there(database):
        return
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
    ended = subprocess.run(
        [sys.executable, "-m", "app.operations.prepare_apart", str(os.getpid())],
        env=inherited | settings_environment(settings),
        stdin=subprocess.DEVNULL,
        check=False,
    )
    if ended.returncode == BUSY:
        raise MigrationBusyError(
            "Another process migrates the database, or on SQLite writes to it, and did not end in time; nothing was "
            "changed. Wait for it to end (or end it, if it hangs), then do the same again."
        )
    if ended.returncode < 0:
        raise UnavailableError(
            f"The process that prepares the database was ended by signal {-ended.returncode} "
            f"({signal.strsignal(-ended.returncode)}): see what ended it, such as a limit of memory."
        )


def main(parent_pid: int) -> int:
    """Prepare; exit status 1 if it could not be done, BUSY if others were at it for the whole patience."""
    die_with_parent(parent_pid)
    settings = Settings()
    configure_logging(settings)
    database = open_database(settings)
    try:
        prepare(database, settings)
    except MigrationBusyError:
        return BUSY
    except Exception:  # noqa: BLE001  # the parent comes upon it too, and knows how to tell it
        return 1
    finally:
        database.dispose()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1])))
