"""A database with the first food table and a weighed item in it: what the item was weighed with is kept, both ways."""

import uuid
from datetime import UTC, date, datetime

import pytest
import sqlalchemy as sa

from app.db.migrate import downgrade, upgrade
from app.db.schema_state import is_current
from app.db.session import Database
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.foods import Food as FoodValue
from app.nutrition.foods import FoodTable
from app.nutrition.importers.imported import ImportedTable, Skipped
from app.services.edit_food import Editor, FoodEdit, edit_food
from app.services.foods import read_food
from app.services.import_foods import import_foods, load_starter
from app.services.search_foods import search_foods

BEFORE = "20261121_unknown_volume"
ONE, NOW = uuid.UUID(int=1), datetime(2026, 11, 21, tzinfo=UTC)
ROWS = {
    "food_release": {
        "id": 1, "name": "tada-starter", "version": "1", "released_on": date(2026, 11, 21), "checksum": "c" * 64,
        "imported_at": NOW, "is_active": True,
    },
    "food": {
        "id": 7, "release_id": 1, "key": "pineapple", "name": "Pineapple", "aliases": [], "food_group": "Fruits",
        "form": "whole", "source_ids": {"sr28_ndb": "09266"},
        "refuse": [
            {"part": "core", "percent": 8.0, "is_served": True}, {"part": "crown", "percent": 16.0, "is_served": False},
        ],
    },
    "component": {"tagname": "ENERC_KCAL", "name": "Energy", "unit": "kcal"},
    "food_nutrient": {"food_id": 7, "tagname": "ENERC_KCAL", "per_100_g": 50.0},
    "food_density": {
        "food_id": 7, "position": 0, "g_per_ml": 0.7, "sd_g_per_ml": 0.1, "state": "chunks", "kind": "bulk",
        "basis": "portion", "source": "a cup",
    },
    "study": {
        "id": ONE, "code": "s", "name": "s", "location_policy": "drop", "change_seq": 1, "created_at": NOW,
    },
    "participant": {"id": ONE, "study_id": ONE, "code": "P", "created_at": NOW},
    "device": {"id": ONE, "participant_id": ONE, "name": "d", "enrolled_at": NOW},
    "meal": {
        "id": ONE, "client_id": ONE, "study_id": ONE, "participant_id": ONE, "device_id": ONE, "captured_at": NOW,
        "utc_offset_minutes": 0, "time_zone": "UTC", "local_date": date(2026, 11, 21), "details": {},
        "status": "estimated", "version": 1, "received_at": NOW,
    },
    "job": {"id": ONE, "meal_id": ONE, "state": "done", "attempts": 1, "enqueued_at": NOW},
    "run": {
        "id": ONE, "meal_id": ONE, "method": "shape", "pipeline_version": "3", "marker": "plain:9x7:11",
        "parameters": {}, "stages": {}, "seconds": 1.0, "food_release_id": 1, "result_key": "k", "created_at": NOW,
    },
    "item": {
        "id": ONE, "run_id": ONE, "position": 0, "rings": [], "volume_ml": 100.0, "volume_low_ml": 90.0,
        "volume_high_ml": 110.0, "relative_sd": {}, "flags": [],
    },
    "item_candidate": {"item_id": ONE, "position": 0, "food_id": 7, "source": "hint"},
    "effective_record": {
        "item_id": ONE, "meal_id": ONE, "study_id": ONE, "participant_id": ONE, "captured_at": NOW,
        "local_date": date(2026, 11, 21), "status": "proposed", "food_id": 7, "volume_ml": 100.0,
        "volume_low_ml": 90.0, "volume_high_ml": 110.0, "density_g_per_ml": 0.7, "density_source": "a cup",
        "mass_g": 70.0, "mass_low_g": 50.0, "mass_high_g": 90.0, "edible_g": 63.0, "energy_kcal": 31.5,
        "change_seq": 1,
    },
}  # fmt: skip


@pytest.fixture
def database(database_url):
    database = Database(database_url)
    upgrade(database, BEFORE)
    with database.write() as session:
        schema = sa.MetaData()
        schema.reflect(session.connection())
        for name, row in ROWS.items():
            table = schema.tables[name]
            session.execute(sa.insert(table).values({key: fitting(table, key, value) for key, value in row.items()}))
        if not database.is_sqlite:
            for name in ("food_release", "food"):  # their next ids, behind the ones above
                session.execute(sa.text(f"SELECT setval(pg_get_serial_sequence('{name}', 'id'), 100)"))
    yield database
    database.dispose()


def fitting(table, key, value):
    """SQLite's reflection knows no UUID type: as hexadecimals."""
    is_text = isinstance(value, uuid.UUID) and not isinstance(table.columns[key].type, sa.Uuid)
    return value.hex if is_text else value


def rows(database, query):
    with database.read() as session:
        return [tuple(row) for row in session.execute(sa.text(query))]


def test_item_keeps_the_density_and_the_edible_share_that_it_was_weighed_with(database):
    upgrade(database)
    assert is_current(database)
    found = rows(
        database,
        "SELECT version, food_id, density_g_per_ml, density_sd_g_per_ml, density_state, density_kind, density_basis, "
        "density_source, density_weighs, edible_share FROM item_food",
    )
    assert found == [(1, 7, 0.7, 0.1, "chunks", "bulk", "portion", "a cup", "as_seen", pytest.approx(0.9))]


def test_item_without_grams_gets_its_share_from_the_refuse(database):
    with database.write() as session:
        session.execute(sa.text("UPDATE effective_record SET mass_g = NULL, edible_g = NULL"))
    upgrade(database)
    assert rows(database, "SELECT edible_share FROM item_food") == [(pytest.approx(76 / 84),)]


def test_figures_releases_and_runs_find_their_new_places(database):
    upgrade(database)
    figures = "SELECT food_id, number, tagname, per_100_g FROM food_nutrient JOIN component c ON c.id = component_id"
    assert rows(database, figures) == [(7, "208", "ENERC_KCAL", 50.0)]
    assert rows(database, "SELECT name, release_id, author FROM food_activation") == [("tada-starter", 1, "migration")]
    assert rows(database, "SELECT source, completed_at IS NOT NULL FROM food_release") == [("starter", True)]
    assert rows(database, "SELECT weighs FROM food_density") == [("edible",)]  # for new items
    assert "tada-starter 1" in str(rows(database, "SELECT food_releases FROM run"))


def test_downgrade_gives_back_what_was(database):
    before = {name: rows(database, f"SELECT * FROM {name}") for name in ROWS}
    upgrade(database)
    downgrade(database, BEFORE)
    for name, old in before.items():
        if name not in {"run", "food", "food_release"}:  # their columns stand in another order
            assert rows(database, f"SELECT * FROM {name}") == old, name
    assert rows(database, "SELECT id, is_active FROM food_release") == [(1, True)]
    assert rows(database, "SELECT id, key, name FROM food") == [(7, "pineapple", "Pineapple")]


@pytest.mark.slow
def test_downgrade_with_imports_and_corrections_leaves_the_starter_in_force_and_lets_all_be_imported_again(database):
    upgrade(database)
    load_starter(database)
    table = FoodTable("fdc", "1", date(2026, 1, 1), "f" * 64, (imported_food("fdc:1", "x" * 300),))
    imported = ImportedTable("fdc", table, (COMPONENT_BY_NUMBER["208"], COMPONENT_BY_NUMBER["262"]), Skipped())
    import_foods(database, imported, "me")
    for name in ("Apfel", "Apfel, rot"):
        edit_food(database, "apple", FoodEdit({"name": name}), Editor("me", "German"))

    downgrade(database, BEFORE)
    in_force = "SELECT r.name, count(f.id) > 700 FROM food_release r JOIN food f ON f.release_id = r.id WHERE is_active"
    assert rows(database, f"{in_force} GROUP BY r.name") == [("tada-starter", True)]
    assert rows(database, "SELECT count(*) FROM food WHERE name IN ('Apfel', 'Apfel, rot')") == [(2,)]

    upgrade(database)
    load_starter(database)
    assert not import_foods(database, imported, "me").was_there
    assert read_food(database, "fdc:1").value.per_100_g == {"208": 50.0, "262": 3.0}
    assert [found.key for found in search_foods(database, "apple", limit=1)] == ["apple"]


def imported_food(key, name):
    return FoodValue(
        key=key, name=name, aliases=(), food_group="Fruits", form="whole", slice_form=None, refuse=(), densities=(),
        per_100_g={"208": 50.0, "262": 3.0}, source_ids={"fdc_id": "1"},
    )  # fmt: skip
