"""What DBOS keeps of jobs that ended is removed after a while: it would grow without end, and nothing reads it again.

Our own rows of jobs stay: they say who estimated which meal when, and are small.
"""

from datetime import UTC, datetime, timedelta

import structlog

from app.db.queries import jobs, privacy
from app.db.session import Database
from app.jobs.engine import APPLICATION

log = structlog.get_logger()

BATCH = 200  # workflows a transaction: short on SQLite, where it holds up every other write
BATCHES = 10  # at one go; the chore comes again soon


def prune_jobs(database: Database, history_days: int) -> int:
    """Remove workflows that ended longer ago, of jobs that are done, failed or erased. Returns how many."""
    before = datetime.now(UTC) - timedelta(days=history_days)
    pruned = 0
    for _ in range(BATCHES):
        with database.write() as session:
            ended = jobs.ended_workflows(session, APPLICATION, before, BATCH)
            privacy.delete_workflows(session, ended)
        pruned += len(ended)
        if len(ended) < BATCH:
            break
    if pruned:
        log.info("workflows_pruned", count=pruned)
    return pruned
