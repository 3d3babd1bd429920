"""Makes one file and ends: `python -m app.file_worker --parent PID --claim HEX`, started by a worker (file_work_chore).

Prints what became of it as a line of JSON on standard output. Asked to end (SIGTERM), it gives its work back.
"""

import argparse
import json
import os
import signal
import sys
import uuid
from dataclasses import asdict
from types import FrameType

import app.tables  # noqa: F401  # defines every table
from app.core.garbage import collect_rarely
from app.core.logs import configure_logging
from app.core.private_files import keep_files_private
from app.core.process_life import die_with_parent
from app.core.settings import Settings
from app.db.session import open_database
from app.exports import file_work_queries as file_work
from app.people.access.secret_box import open_secret_box
from app.releases.file_runner import FileRunner
from app.storage.opening import open_blob_store

NICENESS = 10  # more than the worker's own: estimates and heartbeats go first


class AskedToEndError(BaseException):
    """SIGTERM; no Exception, so that nobody takes it for a fault of the work."""


def main() -> None:
    """Make what waits longest, if anything does."""
    keep_files_private()
    parser = argparse.ArgumentParser(description="Makes one file of tada-server.")
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--claim", type=uuid.UUID, required=True)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the worker decides
    die_with_parent(arguments.parent)
    os.nice(NICENESS)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    settings = Settings()
    configure_logging(settings)
    collect_rarely()
    database = open_database(settings)
    try:
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        box = open_secret_box(settings)
        ended = FileRunner(database, blobs, settings, box, arguments.claim).run_one()
        told = {} if ended is None else asdict(ended)
    except AskedToEndError:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        with database.write() as session:
            file_work.put_back(session, arguments.claim, counts=False)
        told = {"kind": "export", "outcome": "again"}
    finally:
        database.dispose()
    json.dump(told, answers, default=str)
    answers.write("\n")
    answers.flush()
    sys.stderr.flush()


def _end(_number: int, _frame: FrameType | None) -> None:
    raise AskedToEndError


if __name__ == "__main__":
    main()
