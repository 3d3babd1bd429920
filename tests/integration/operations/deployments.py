"""Whole deployments to back up and to restore into: a database, a store, a ledger and a key of their own."""

import contextlib
import hashlib
import json
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from fastapi.testclient import TestClient

from app.core.settings import Settings
from app.db.base import Base
from app.db.session import Database
from app.jobs import queries as jobs
from app.main import create_app
from app.meals.estimate.save_estimate import save_estimate
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import Run, RunArtefact
from app.meals.stored.run_answer import RunAnswer
from app.operations.backup.restore import restore
from app.operations.backup.table_files import TRANSIENT_TABLES
from app.operations.backup.write_backup import backup_to_file
from app.people.access.secret_box import open_secret_box
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store
from tests.support import estimates

SECRET = "a key for tests only, of no worth"


def quiet(_words):
    """Nobody watches the progress."""


@dataclass(frozen=True)
class Deployment:
    """What a machine has: its settings; database and store are opened from them."""

    settings: Settings
    database: Database
    blobs: BlobStore

    @property
    def box(self):
        return open_secret_box(self.settings)

    def back_up(self, path, tell=quiet):
        return backup_to_file(self.database, self.blobs, self.box, path, tell)

    def restore(self, path, **options):
        return restore(path, self.database, self.blobs, self.settings, quiet, **options)

    @contextlib.contextmanager
    def served(self):
        """A client of this deployment's server."""
        with TestClient(create_app(self.settings), raise_server_exceptions=False) as client:
            yield client

    def rows(self):
        """Table -> its rows by key, as the models read them."""
        found = {}
        with self.database.read() as session:
            for table in Base.metadata.sorted_tables:
                if table.name in TRANSIENT_TABLES:
                    continue
                columns = [sa.type_coerce(column, column.type).label(column.name) for column in table.columns]
                rows = session.execute(sa.select(*columns)).mappings()
                keys = [column.name for column in table.primary_key.columns]
                found[table.name] = {tuple(row[key] for key in keys): dict(row) for row in rows}
        return found

    def stored(self):
        """Key -> bytes of every blob in the store."""
        listed = self.blobs.keys()
        return {blob.key: self.blobs.read(blob.key) for blob in listed}


@contextlib.contextmanager
def deployment(folder, database_url, **settings):
    """A deployment on a database that is there, perhaps empty."""
    given = {"secret_key": SECRET, "min_free_bytes": 0, "max_photo_bytes": 400_000, "enrolment_attempts_per_minute": 60}
    made = Settings(data_dir=folder, database_url=database_url, **given | settings)
    database = Database(database_url)
    try:
        yield Deployment(made, database, open_blob_store(made.resolved_blob_url, made))
    finally:
        database.dispose()


def store_what_is_named(database, blobs):
    """Give rows of runs that a test made up the blobs that they name, under keys that tell their bytes."""
    with database.write() as session:
        for run in session.scalars(sa.select(Run)):
            content = f'{{"run": "{run.id}"}}'.encode()
            run.result_key = stored_under(blobs, f"{run.meal_id}/runs/{run.id}/result.json", content)
        for artefact in session.scalars(sa.select(RunArtefact)):
            content = f"{artefact.name} of {artefact.run_id}".encode()
            artefact.blob_key = stored_under(blobs, f"runs/{artefact.run_id}/{artefact.name}", content)
            artefact.sha256, artefact.bytes = artefact.blob_key[-64:], len(content)


def stored_under(blobs, prefix, content):
    key = f"{prefix}/{hashlib.sha256(content).hexdigest()}"
    blobs.put_bytes(key, content)
    return key


def named_blobs(database):
    """The keys that rows name and that are not erased."""
    with database.read() as session:
        return {
            *session.scalars(sa.select(MealImage.blob_key).where(MealImage.erased_at.is_(None))),
            *session.scalars(sa.select(RunArtefact.blob_key)),
            *session.scalars(sa.select(Run.result_key)),
        }


def estimate(state, client_id):
    """A meal is estimated as a worker does it: the answer is stored, then its rows are written."""
    body = estimates.answer(estimates.found_item(hint=0))
    with state.database.read() as session:
        found = session.execute(
            sa.select(Job.id, Job.meal_id)
            .join(Meal, Meal.id == Job.meal_id)
            .where(Meal.client_id == uuid.UUID(client_id))
        ).one()
    key = stored_under(state.blobs, f"{found.meal_id}/runs/{found.id}/result.json", json.dumps(body).encode())
    with state.database.write() as session:
        save_estimate(session, found.id, RunAnswer.model_validate(body), key)
        jobs.finish_job(session.get_one(Job, found.id), datetime.now(UTC))
