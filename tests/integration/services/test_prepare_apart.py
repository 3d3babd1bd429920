"""Migrations and the starter table take memory once: not that of the process that serves."""

import sqlalchemy as sa

from app.db.schema_state import is_current
from app.db.session import Database
from app.services import prepare_apart as module
from app.services.import_foods import is_starter_there
from app.services.prepare_apart import prepare_apart
from app.settings import Settings


def test_an_empty_database_is_made_ready_by_another_process(database_url, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "prepare", None)  # not by this one
    database = Database(database_url)
    prepare_apart(database, Settings(data_dir=tmp_path, database_url=database_url, secret_key="k" * 40))
    assert is_current(database)
    assert is_starter_there(database)
    database.dispose()


def test_no_process_is_started_where_all_is_there(prepared_database_url, tmp_path, monkeypatch):
    monkeypatch.setattr(module.subprocess, "run", None)
    database = Database(prepared_database_url)
    prepare_apart(database, Settings(data_dir=tmp_path, database_url=prepared_database_url))
    with database.write() as session:
        session.execute(sa.text("UPDATE food_release SET checksum = 'another version'"))
    assert not is_starter_there(database)
    database.dispose()


def test_what_goes_wrong_there_is_left_to_who_prepares_next(database_url, tmp_path, capfd):
    database = Database(database_url)
    prepare_apart(database, Settings(data_dir=tmp_path, database_url=database_url, erasure_url="nonsense://here"))
    assert "Traceback" not in capfd.readouterr().err
    assert is_current(database)  # as far as it came
    database.dispose()
