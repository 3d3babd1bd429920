"""The worker's part in making files: a side process makes them, one at a time; files whose time is over go."""

import os
import sys
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from app.children.side_process import SideProcess
from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.jobs.supervisor import settings_environment
from app.metrics import instruments

COMMAND = (sys.executable, "-m", "app.file_worker")
BATCH = 200
TOLD_FOR = timedelta(days=30)  # what has ended without a file stays in the list so long


def file_process(
    database: Database,
    settings: Settings,
    *,
    command: Sequence[str] = COMMAND,
    lease_seconds: float = file_work.LEASE_SECONDS,
) -> SideProcess:
    """The side process of one worker. command, lease_seconds: others in tests."""

    def has_work() -> bool:
        with database.read() as session:
            return file_work.has_work(session, lease_seconds)

    def on_end(claim: str, ended: Mapping[str, Any] | None, is_asked: bool) -> None:
        """Count it; what a process that died had goes back at once, not with its lease.

        One that was asked to end and was too slow in it is no try that failed.
        """
        if ended is None:
            with database.write() as session:
                file_work.put_back(session, uuid.UUID(claim), counts=not is_asked)
            instruments.FILES_MADE.labels("export", "again" if is_asked else "died").inc()
        elif ended.get("outcome") is not None:
            kind, outcome = str(ended["kind"]), str(ended["outcome"])
            instruments.FILES_MADE.labels(kind, instruments.outcome_label(outcome)).inc()

    inherited = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
    return SideProcess(
        command,
        inherited | settings_environment(settings),
        has_work=has_work,
        new_claim=lambda: uuid.uuid4().hex,
        on_end=on_end,
    )


def expire_exports(database: Database, now: datetime | None = None) -> int:
    """Files whose time is over are to go, and old lines of the list. Returns how many files."""
    now, total = now or datetime.now(UTC), 0
    while True:
        with database.write() as session:
            count = exports.expire_due(session, now, BATCH)
            exports.forget_ended(session, now - TOLD_FOR)
        total += count
        if count < BATCH:
            return total
