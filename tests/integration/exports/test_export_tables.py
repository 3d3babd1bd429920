"""The exported tables: the same values in every format, long as wide, equal to the API's."""

import contextlib
import io
import itertools
import json
import math

import pytest
import sqlalchemy as sa
from pyarrow import parquet

from app.exports.data_dictionary import columns_for
from app.exports.export_file import export_request
from app.exports.export_spec import WITHOUT_COMPONENTS, ExportSpec
from app.exports.export_table import export_table
from app.exports.live_tables import live_tables
from app.meals.stored.item_state import fold_meal
from app.meals.stored.meal_parts import parts_of
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item
from app.people.access.caller import StaffCaller
from app.people.models import Staff
from tests.integration.exports.test_record_exports import parquet_value, plain_csv

pytestmark = pytest.mark.slow

ONE_SEED = pytest.mark.parametrize("talked_over", [3], indirect=True)
SEEDS = pytest.mark.parametrize("talked_over", [0, 3], indirect=True)
EXACT = 1e-9  # sums in another order
TABLES = [
    ExportSpec(rows, layout, components=components)
    for rows in ("items", "meals", "days")
    for layout in ("wide", "long")
    for components in ("headline", "all")
] + [
    *(ExportSpec(rows) for rows in WITHOUT_COMPONENTS),
    *(ExportSpec(rows, provenance=False) for rows in ("items", "meals")),
]


@pytest.fixture
def researcher(state, admin):
    with state.database.read() as session:
        found = session.scalars(sa.select(Staff)).one()
        return StaffCaller(found.id, found.name, is_admin=True, token_id=found.id)


@pytest.fixture
def export(state, tmp_path):
    """The bytes of a table. A copy of SQLite's file is read: this process holds locks on the file itself."""

    def export(spec, output):
        wanted = ExportSpec(spec.rows, spec.layout, output, spec.components, spec.filters, spec.provenance)
        url, path = state.database.url, tmp_path / "table"
        if state.database.is_sqlite:
            copy = tmp_path / "copy.sqlite"
            copy.unlink(missing_ok=True)
            with contextlib.closing(state.database.write_engine.raw_connection()) as connection:
                connection.cursor().execute(f"VACUUM INTO '{copy}'")
            url = f"sqlite:///{copy}"
        with live_tables(url, tmp_path) as connection:
            export_table(connection, export_request(wanted, None, None, path))
        return path.read_bytes()

    return export


@pytest.fixture
def rows(export):
    """A table's rows, by NDJSON."""
    return lambda *args, **kwargs: [
        json.loads(line) for line in export(ExportSpec(*args, **kwargs), "ndjson").splitlines()
    ]


@ONE_SEED
def test_csv_ndjson_and_parquet_have_the_same_values(talked_over, export, state, researcher):
    for spec in TABLES:
        columns = columns_for(state.database, researcher, spec)
        names = [column.name for column in columns]
        assert len(set(names)) == len(names)
        told = [json.loads(line) for line in export(spec, "ndjson").splitlines()]
        assert told, spec
        assert all(list(row) == names for row in told)
        assert export(spec, "csv") == plain_csv(names, told), spec
        table = parquet.read_table(io.BytesIO(export(spec, "parquet")))
        assert [{name: parquet_value(value) for name, value in row.items()} for row in table.to_pylist()] == told
        nullable = {column.name for column in columns if column.empty is not None}
        empty = {name for row in told for name, value in row.items() if value is None}
        assert empty <= nullable, (spec, empty - nullable)
        for column in columns:
            if column.values:
                assert {row[column.name] for row in told} <= {*column.values, None}, column


@ONE_SEED
def test_long_rows_are_the_wide_ones_columns(talked_over, rows):
    keys = {"items": ("id",), "meals": ("meal_id",), "days": ("participant", "local_date")}
    for (table, key), components in itertools.product(keys.items(), ("headline", "all")):
        wide = {tuple(row[name] for name in key): row for row in rows(table, "wide", components=components)}
        long = rows(table, "long", components=components)
        assert {tuple(row[name] for name in key) for row in long} == set(wide)
        for row in long:
            of_wide = wide[tuple(row[name] for name in key)]
            column = row["component"] if row["component"] in of_wide else row["component"].lower()  # FAT_g: fat_g
            assert row["amount"] == (of_wide[column] if column == row["component"] else pytest.approx(of_wide[column]))
            assert row["known"] is (row["amount"] is not None)
            if table != "items":
                assert row["coverage"] == of_wide[f"{column}_coverage"]
        for component in {row["component"] for row in long}:
            column = component if component in next(iter(wide.values())) else component.lower()
            total = math.fsum(row["amount"] or 0.0 for row in long if row["component"] == component)
            assert total == pytest.approx(math.fsum(row[column] or 0.0 for row in wide.values()), rel=EXACT)


@SEEDS
def test_provenance_of_items_is_what_their_meals_fold_to(talked_over, rows, state, phone):
    told = {row["id"]: row for row in rows("items")}
    seen = {}
    with state.database.read() as session:
        for parts in parts_of(session, session.scalars(sa.select(Meal)).all()):
            for each in fold_meal(parts).items:
                seen[str(each.item.id)] = each
        assert set(told) <= {str(one) for one in session.scalars(sa.select(Item.id))}
    assert set(told) == set(seen)
    for item_id, row in told.items():
        its = seen[item_id].food_assignment
        assert row["run_id"] == (str(seen[item_id].run_id) if seen[item_id].run_id else None)
        assert (row["method"] is None) == (row["run_id"] is None)
        assert row["food_said_by"] == (its.layer if its else None)
        assert row["edible_share"] == (its.edible_share if its else None)
    for meal_id in {row["meal_id"] for row in told.values()}:
        for item in phone.get(f"/v1/meals/{meal_id}").json()["items"]:
            row = told[item["id"]]
            for name in ("density_basis", "density_sd_g_per_ml", "density_source", "flags", "status", "consumed_g"):
                assert row[name] == item[name], name


@ONE_SEED
def test_meals_total_what_the_meal_itself_tells(talked_over, rows, phone):
    told = rows("meals", components="all")
    assert len(told) >= 6
    for row in told:
        meal = phone.get(f"/v1/meals/{row['meal_id']}").json()
        totals = meal["totals"]
        assert row["status"] == meal["status"]
        assert row["unmeasured_items"] == totals["unmeasured_items"]
        assert row["consumed_g"] == (
            pytest.approx(totals["consumed_g"], rel=EXACT) if totals["consumed_g"] is not None else None
        )
        by_tagname = {one["tagname"]: one["amount"] for one in totals["nutrients"]}
        for name, tagname in (("energy_kcal", "ENERC_KCAL"), ("FE_mg", "FE"), ("VITC_mg", "VITC")):
            wanted = by_tagname.get(tagname)
            if wanted is not None or row["items"]:
                assert row[name] == (pytest.approx(wanted, rel=EXACT) if wanted is not None else None)
        run = meal["run"] or {}
        assert (row["run_id"], row["pipeline_version"]) == (run.get("id"), run.get("pipeline_version"))
        assert row["food_tables"] == ("; ".join(run["food_tables"]) if run else None)
        for slot in ("left", "right"):
            its = meal["images"].get(slot, {})
            assert row[f"{slot}_received_sha256"] == its.get("received_sha256")


@ONE_SEED
def test_days_are_those_of_the_pages(talked_over, rows, client, admin):
    told = rows("days")
    pages = client.get("/v1/days?limit=1000", headers=admin).json()["items"]
    assert [row.keys() for row in told] == [row.keys() for row in pages]
    assert told == pages
    everything = rows("days", components="all")
    assert {row["ENERC_KCAL_kcal"] for row in everything} != {None}
    for row in everything:
        for one, other in (("energy_kcal", "ENERC_KCAL_kcal"), ("sodium_mg", "NA_mg")):
            for end in ("", "_coverage"):
                value = row[f"{one}{end}"]
                assert row[f"{other}{end}"] == (pytest.approx(value, rel=EXACT) if value is not None else None)
