"""All records of a filter as a file: CSV, NDJSON and Parquet have what the pages of JSON have, of one moment."""

import csv
import io
import json
import os
import sys
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from urllib.parse import urlencode

import pytest
import sqlalchemy as sa
from pyarrow import parquet
from pydantic_core import to_json

from app.core.errors import UnavailableError
from app.exports import file_task
from app.exports.export_file import make_export
from app.exports.export_places import ExportPlaces
from app.exports.export_spec import ExportSpec
from app.exports.file_task import FileTasks
from app.http.columns.record_columns import PROVENANCE_COLUMNS, RECORD_COLUMNS
from app.http.flat_list import safe_cell
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.caller import StaffCaller
from app.people.models import Participant, Staff
from app.records.schemas import RecordOut
from tests.integration.diary.eaten_days import add_meal, eaten_item, set_profile
from tests.integration.meals.upload.answers import refusal

FILE_COLUMNS = (*RECORD_COLUMNS, *PROVENANCE_COLUMNS)
RECORD_NAMES = [column.name for column in RECORD_COLUMNS if column.name != "captured_local"]  # which files alone have
FILE_NAMES = [column.name for column in FILE_COLUMNS]


@pytest.fixture
def eaten(enrol, state):
    """Records of all kinds: nulls, unicode, what a spreadsheet computes, microseconds, numbers large and small."""
    with_codes = {"P001": "P001", "P002": "=2+3", "P003": "Zoë,\u201cx\u201d\n"}
    for code in with_codes:
        enrol(code)
    add_meal(state, "P001", "2026-11-01", eaten_item(None, status="needs_review"), delay=timedelta(microseconds=1))
    add_meal(
        state,
        "P002",
        "2026-11-02",
        eaten_item(0.1 + 0.2, "apple", energy_kcal=1e-7, sodium_mg=1e22, protein_g=0.0, volume_ml=185.0,
                   volume_low_ml=-1.5, volume_high_ml=3.0, density_g_per_ml=0.8, density_source='@ "FAO", 2012',
                   provisional=True, reviewed=True, status="corrected"),
        eaten_item(-3.0, "banana", status="rejected"),
    )  # fmt: skip
    add_meal(state, "P003", "2026-11-03", eaten_item(5.0, "apple"), delay=timedelta(days=40, seconds=0.3))
    set_profile(state, starts_on=date(2026, 10, 30))
    with state.database.write() as session:
        for participant in session.scalars(sa.select(Participant)):
            participant.code = with_codes[participant.code]
        meal = session.scalars(sa.select(Meal).where(Meal.local_date == date(2026, 11, 3))).one()
        meal.captured_at = datetime(2026, 11, 3, 12, 0, 0, 123456, UTC)
        changed = sa.update(EffectiveRecord).where(EffectiveRecord.meal_id == meal.id)
        session.execute(changed.values(captured_at=meal.captured_at, flags=["=flag", "other_flag"]))


def flat(record):
    food = record.pop("food") or {"key": None, "name": None}
    del record["nutrient_intervals"]
    return record | {"food_key": food["key"], "food_name": food["name"]}


def pages(client, headers, **params):
    rows, path = [], f"/v1/records?{urlencode(params | {'limit': 2}, doseq=True)}"
    while path:
        page = client.get(path, headers=headers).json()
        rows += [flat(record) for record in page["items"]]
        path = page["next"]
    return rows


def fetch(client, headers, output, **params):
    answer = client.get("/v1/records", headers=headers, params=params | {"format": output})
    assert answer.status_code == 200
    return answer.content


def parquet_value(value):
    if isinstance(value, datetime):
        return value.isoformat().replace("+00:00", "Z")
    return value.isoformat() if isinstance(value, date) else value


def test_exported_columns_are_the_records_of_the_api():
    names = [
        name
        for field in RecordOut.model_fields
        if field != "nutrient_intervals"  # in a file they follow from the grams' (docs/exports.md)
        for name in ([field] if field != "food" else ["food_key", "food_name"])
    ]
    assert names == RECORD_NAMES
    ends = (("_g_per_ml", "g/ml"), ("_ml", "ml"), ("_kcal", "kcal"), ("_mg", "mg"), ("_g", "g"), ("_seconds", "s"))
    for column in FILE_COLUMNS:
        unit = next((unit for end, unit in ends if column.name.endswith(end)), None)
        assert column.unit == ("1" if column.name in {"share", "edible_share", "doubt"} else unit), column.name


def plain_csv(names, rows):
    """The file by csv.writer, cell by cell."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)
    writer.writerow(names)
    for row in rows:
        values = [row[name] for name in names]
        writer.writerow([to_json(one).decode() if isinstance(one, float) else safe_cell(one) for one in values])
    return buffer.getvalue().encode()


@pytest.mark.both_stores
@pytest.mark.usefixtures("eaten")
def test_ndjson_and_parquet_have_the_values_of_the_pages_and_csv_is_that_of_a_plain_writer(client, admin):
    expected = pages(client, admin)
    assert len(expected) == 4
    assert expected[0]["study_day"] == 3
    lines = fetch(client, admin, "ndjson")
    rows = [json.loads(line) for line in lines.splitlines()]
    assert [{name: row[name] for name in RECORD_NAMES} for row in rows] == expected
    assert [list(row) for row in rows] == [FILE_NAMES] * len(expected)
    assert csv_rows(fetch(client, admin, "csv").decode()) == csv_rows(plain_csv(FILE_NAMES, rows).decode())
    table = parquet.read_table(io.BytesIO(fetch(client, admin, "parquet")))
    assert [{name: parquet_value(value) for name, value in row.items()} for row in table.to_pylist()] == rows


def csv_rows(text):
    """Cells; numbers by their value."""

    def cell(value):
        try:
            return float(value)
        except ValueError:
            return value

    return [list(map(cell, row)) for row in csv.reader(io.StringIO(text, newline=""))]


@pytest.fixture
def export(state, admin, eaten):
    with state.database.read() as session:
        staff_id = session.scalars(sa.select(Staff.id)).one()
    caller = StaffCaller(staff_id=staff_id, name="admin", is_admin=True, token_id=staff_id)
    parts = state.database, state.blobs, state.settings, state.part(ExportPlaces)
    return lambda: make_export(*parts, caller, ExportSpec("items"))


def test_failure_is_an_error_that_leaves_the_place_and_no_file(client, admin, export, state, monkeypatch):
    for error, code in (
        (RuntimeError("a fault of ours"), (500, "internal_error")),
        (UnavailableError("the database is away"), (503, "unavailable")),
    ):

        def fail(*_, error=error, **__):
            raise error

        with monkeypatch.context() as patch:
            patch.setattr(FileTasks, "run", fail)
            for _ in range(4):
                assert refusal(client.get("/v1/records?format=csv", headers=admin)) == code
        assert client.get("/v1/records?format=csv", headers=admin).status_code == 200
    assert not list(state.blobs.staging_folder().iterdir())


def test_process_that_dies_is_an_error(client, admin, export, monkeypatch):
    monkeypatch.setattr(file_task, "COMMAND", (sys.executable, "-c", "import sys; sys.stdin.read(); sys.exit(9)"))
    assert refusal(client.get("/v1/records?format=csv", headers=admin)) == (500, "internal_error")


def test_file_is_made_in_a_process_that_has_not_opened_the_database_before(state, export, monkeypatch):
    """DuckDB's SQLite in a process with Python's would drop its locks."""
    seen = []
    wait = FileTasks._wait

    def look(tasks, process, *rest):
        seen.append(process.pid)
        wait(tasks, process, *rest)

    monkeypatch.setattr(FileTasks, "_wait", look)
    export().close()
    assert seen
    assert os.getpid() not in seen
    assert "duckdb" not in {name.partition(".")[0] for name in open_libraries(os.getpid())}


def open_libraries(pid):
    """Names of the files of a process that end in .duckdb_extension, which attaches databases."""
    maps = Path(f"/proc/{pid}/maps").read_text("utf-8").split()
    return [Path(name).name for name in maps if name.endswith("scanner.duckdb_extension")]


def test_third_export_at_once_or_one_without_room_on_the_disk_is_told_to_come_back(client, admin, export, monkeypatch):
    files = [export(), export()]
    assert refusal(client.get("/v1/records?format=csv", headers=admin)) == (503, "server_busy")
    for file in files:
        file.close()
    assert client.get("/v1/records?format=csv", headers=admin).status_code == 200
    monkeypatch.setattr("app.exports.file_task.shutil.disk_usage", lambda _: type("Usage", (), {"free": -1}))
    assert refusal(client.get("/v1/records?format=csv", headers=admin)) == (503, "storage_full")
