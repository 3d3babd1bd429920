"""A database with rows in all tables is brought up to date and back: rows survive, references and triggers too."""

import sqlite3

import pytest
import sqlalchemy as sa

from app.core.errors import ConflictError
from app.db.base import Base
from app.db.migrate import downgrade, upgrade
from app.db.schema_state import current_revision, head_revision, is_current
from tests.integration.db.full_tables import assert_survived, fill_tables, rows_of

BASELINE = head_revision()


@pytest.fixture
def full(database):
    """At the newest migration of ours, with a row in each table."""
    fill_tables(database)
    return database


def execute(database, statement):
    with database.write() as session:
        session.execute(sa.text(statement))


@pytest.mark.both_stores
def test_rows_survive_the_way_up_and_back_and_references_and_triggers_hold_for_tables_made_anew(full, next_migration):
    before = rows_of(full)
    assert {table for table, rows in before.items() if rows} == set(Base.metadata.tables)
    revision = next_migration()
    upgrade(full)
    assert current_revision(full) == revision
    assert_survived(before, rows_of(full))
    downgrade(full, BASELINE)
    assert current_revision(full) == BASELINE
    assert rows_of(full) == before
    upgrade(full)
    with pytest.raises(sa.exc.IntegrityError):
        execute(full, "DELETE FROM item")
    with pytest.raises(sa.exc.DatabaseError, match="append-only"):
        execute(full, "DELETE FROM audit_event")


def test_broken_reference_stops_the_upgrade_and_nothing_is_changed(full, next_migration):
    """On SQLite: PostgreSQL alters tables in place and lets no reference break."""
    with sqlite3.connect(full.write_engine.url.database) as connection:  # foreign keys are off
        connection.execute("DELETE FROM run")
    connection.close()
    before = rows_of(full)
    next_migration()
    with pytest.raises(sa.exc.IntegrityError, match="dangling references"):
        upgrade(full)
    assert current_revision(full) == BASELINE
    assert rows_of(full) == before
    with pytest.raises(sa.exc.IntegrityError):
        execute(full, "DELETE FROM study")


def test_schema_goes_down_to_nothing_and_up_again(full):
    downgrade(full, "base")
    assert rows_of(full) == {}
    with full.read() as session:
        assert sa.inspect(session.connection()).get_table_names() in ([], ["alembic_version"])
    upgrade(full)
    assert is_current(full)


@pytest.mark.parametrize(
    ("change", "behind", "reason"),
    [
        ("UPDATE run SET marker = NULL", "20261127_reshape", "no place for runs without a marker"),
        ("UPDATE camera_calibration SET rms_px = NULL", "20261127_reshape", "no place for rigs"),
        ("UPDATE meal_image SET slot = 'left_depth'", "20261127_rigs", "no place for depth maps"),
        ("UPDATE meal_image SET slot = 'voice_note'", "20261127_sandbox", "no place for voice notes"),
        ("UPDATE study SET is_sandbox = true", "20261127_web_origins", "no place for sandbox studies"),
    ],
)
def test_way_back_is_refused_while_the_older_schema_has_no_place_for_a_row(full, change, behind, reason):
    execute(full, change)
    before = rows_of(full)
    with pytest.raises(ConflictError, match=reason):
        downgrade(full, behind)
    assert rows_of(full) == before
    assert is_current(full)


@pytest.mark.slow
def test_each_migration_takes_back_what_it_brought_and_brings_it_again(full):
    execute(full, "UPDATE meal_event SET kind = 'reshape'")
    before = rows_of(full)
    downgrade(full, "20261127_voice_notes")
    rows = rows_of(full)
    assert "push_subscription" not in rows
    assert "reminder_times" not in rows["study"][0]
    downgrade(full, "20261127_web_origins")
    assert "is_sandbox" not in rows_of(full)["study"][0]
    downgrade(full, "20261127_depth_maps")
    rows = rows_of(full)
    assert "web_origins" not in rows["study"][0]
    downgrade(full, "20261127_rigs")
    assert rows_of(full) == rows
    with pytest.raises(sa.exc.IntegrityError):
        execute(full, "UPDATE meal_image SET slot = 'left_depth'")
    downgrade(full, "20261127_reshape")
    assert {"rig", "study_id"}.isdisjoint(rows_of(full)["camera_calibration"][0])
    downgrade(full, "20261124_baseline")
    assert [row["kind"] for row in rows_of(full)["meal_event"]] == ["set_volume"]  # what the form by hand came to
    with pytest.raises(sa.exc.IntegrityError):
        execute(full, "UPDATE meal_event SET kind = 'reshape'")
    upgrade(full)
    execute(full, "UPDATE meal_event SET kind = 'reshape'")
    # by an import; by phones; by who signs in; by owners
    made_again = {"packaged_food": [], "push_subscription": [], "sign_in_attempt": [], "taught_photograph": []}
    made_again |= {"review_decision": [], "known_item": [], "reference_day": []}  # by reviewers and owners
    assert rows_of(full) == before | made_again
    assert rows_of(full)["study"][0]["is_sandbox"] in (False, 0)
    assert rows_of(full)["study"][0]["web_origins"] is None
    execute(full, "UPDATE meal_image SET slot = 'left_depth'")


@pytest.mark.both_stores
def test_value_that_cannot_be_is_refused_by_the_database_and_an_unknown_volume_with_its_interval_is_not(full):
    for change in (
        "UPDATE item SET volume_low_ml = NULL",
        "UPDATE effective_record SET status = 'eaten'",
        "UPDATE meal SET status = 'eaten'",
    ):
        with pytest.raises(sa.exc.IntegrityError):
            execute(full, change)
    execute(full, "UPDATE item SET volume_ml = NULL, volume_low_ml = NULL, volume_high_ml = NULL")
    execute(full, "UPDATE effective_record SET volume_ml = NULL")
