"""Make a deployment usable: schema, job tables, starter food table. Safe to run by several processes at once, again."""

from app.db.migrate import upgrade
from app.db.session import Database
from app.jobs.engine import prepare_job_tables
from app.services.import_foods import load_starter
from app.settings import Settings


def prepare(database: Database, settings: Settings) -> None:
    """Bring everything up to date; what is already there stays as it is."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    upgrade(database)
    prepare_job_tables(database)
    load_starter(database)
