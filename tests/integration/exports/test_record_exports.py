"""All records of a filter as a file: CSV, NDJSON and Parquet have what the pages of JSON have, of one moment."""

import csv
import io
import json
import threading
from datetime import UTC, date, datetime, timedelta
from types import SimpleNamespace
from urllib.parse import urlencode

import pytest
import sqlalchemy as sa
from pyarrow import parquet
from pydantic_core import to_json

from app.diary import day_summaries
from app.exports import spooled_export
from app.exports.export_file import begin_export
from app.exports.export_places import ExportPlaces
from app.exports.export_spec import ExportSpec
from app.exports.tables import export_days, export_tables
from app.exports.tables import record_queries as record_export
from app.http.tables import columns
from app.http.tables.columns import columns_of
from app.http.tables.csv_rows import safe_cell
from app.http.tables.record_columns import PROVENANCE_PARTS, RECORD_COLUMNS, RECORD_PARTS
from app.http.tables.spool import Spool
from app.meals.models import Meal
from app.meals.record_models import EffectiveRecord
from app.people.access.caller import StaffCaller
from app.people.models import Participant, Staff
from app.records.schemas import RecordOut
from tests.integration.diary.eaten_days import add_meal, eaten_item, set_profile
from tests.integration.uploads.answers import refusal
from tests.support.waiting import PATIENCE_SECONDS, wait_until

FILE_COLUMNS = columns_of((*RECORD_PARTS, *PROVENANCE_PARTS))
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
        session.execute(changed.values(captured_at=meal.captured_at, flags=["=flag", "größer"]))


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


@pytest.mark.usefixtures("eaten")
@pytest.mark.parametrize("batch", [1, 3, 2000])
def test_ndjson_and_parquet_have_the_values_of_the_pages_and_csv_is_that_of_a_plain_writer(
    client, admin, monkeypatch, batch
):
    monkeypatch.setattr(record_export, "ROWS_A_BATCH", batch)
    monkeypatch.setattr(columns, "MOST_CONVERTED", 1)  # all is forgotten in between, and made again
    expected = pages(client, admin)
    assert len(expected) == 4
    assert expected[0]["study_day"] == 3
    lines = fetch(client, admin, "ndjson")
    rows = [json.loads(line) for line in lines.splitlines()]
    assert [{name: row[name] for name in RECORD_NAMES} for row in rows] == expected
    assert [list(row) for row in rows] == [FILE_NAMES] * len(expected)
    assert lines == b"".join(to_json(row) + b"\n" for row in rows)
    assert fetch(client, admin, "csv") == plain_csv(FILE_NAMES, rows)
    table = parquet.read_table(io.BytesIO(fetch(client, admin, "parquet")))
    assert [{name: parquet_value(value) for name, value in row.items()} for row in table.to_pylist()] == rows
    assert table.schema.field("energy_kcal").metadata[b"unit"] == b"kcal"


def exporter(state, staff_id):
    caller = StaffCaller(staff_id=staff_id, name="admin", is_admin=True, token_id=staff_id)
    parts = state.database, state.blobs, state.settings, state.part(ExportPlaces)
    return lambda output="csv": begin_export(*parts, caller, ExportSpec("items", output=output))


@pytest.fixture
def export(state, admin, eaten):
    with state.database.read() as session:
        return exporter(state, session.scalars(sa.select(Staff.id)).one())


def wait_for_end_of_exports():
    wait_until(lambda: not any(thread.name.startswith("export-") for thread in threading.enumerate()), "exports to end")


@pytest.fixture
def held_after_the_first_row(monkeypatch):
    """An export's writer waits behind the header and the first row: what it has written, and how to let it go on."""
    written, go_on = [], threading.Event()
    write = Spool.write

    def slow_write(spool, data):
        write(spool, data)
        written.append(data)
        if len(written) == 2:
            assert go_on.wait(PATIENCE_SECONDS)

    monkeypatch.setattr(Spool, "write", slow_write)

    def wait():
        wait_until(lambda: len(written) >= 2, "the first row")
        return go_on.set

    return wait


def test_export_is_of_one_moment_and_gives_the_database_back_before_the_reader_reads(
    state, export, monkeypatch, held_after_the_first_row
):
    monkeypatch.setattr(record_export, "ROWS_A_BATCH", 1)
    file = export()
    go_on = held_after_the_first_row()
    with state.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(energy_kcal=77.0))
    go_on()
    wait_for_end_of_exports()  # and nobody has read a byte
    text = b"".join(file.pieces).decode()
    file.close()
    assert len(text.splitlines()) >= 5
    assert "77.0" not in text


@pytest.mark.usefixtures("eaten")
def test_days_as_csv_are_of_one_moment(state, client, admin, monkeypatch, held_after_the_first_row):
    monkeypatch.setattr(day_summaries, "STREAM_PAGE", 1)
    monkeypatch.setattr(export_days, "DAYS_A_BATCH", 1)
    answers = []
    reader = threading.Thread(target=lambda: answers.append(client.get("/v1/days?format=csv", headers=admin).text))
    reader.start()
    go_on = held_after_the_first_row()
    with state.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(energy_kcal=77.0))
    go_on()
    reader.join(PATIENCE_SECONDS)
    rows = list(csv.DictReader(io.StringIO(answers[0], newline="")))
    assert len(rows) == 3
    assert "77.0" not in [row["energy_kcal"] for row in rows]


def test_reader_who_leaves_ends_the_query_and_a_failure_in_the_midst_breaks_the_file_off(export, monkeypatch):
    monkeypatch.setattr(record_export, "ROWS_A_BATCH", 1)
    batches, left = [], threading.Event()
    write = Spool.write

    def counted(spool, data):
        batches.append(data)
        if len(batches) == 2:
            assert left.wait(PATIENCE_SECONDS)
        write(spool, data)

    def broken(output, parts, batches):
        yield b"a part"
        raise ConnectionError("the database went away")

    with monkeypatch.context() as patch:
        patch.setattr(Spool, "write", counted)
        file = export()
        next(file.pieces)
        file.close()
        left.set()
        wait_for_end_of_exports()
    assert len(batches) == 2  # of the five that there would have been
    monkeypatch.setattr(export_tables, "encoded", broken)
    file = export()
    assert next(file.pieces) == b"a part"
    with pytest.raises(ConnectionError):
        next(file.pieces)
    file.close()


def test_failure_before_the_first_byte_is_an_error_and_leaves_the_place(client, admin, export, monkeypatch):
    class NoThread:
        def __init__(self, **_):
            pass

        def start(self):
            raise RuntimeError("can't start new thread")

    def broken(output, parts, batches):
        raise RuntimeError("a fault of ours")

    for module, name, value, code in (
        (export_tables, "encoded", broken, (500, "internal_error")),
        (spooled_export, "threading", SimpleNamespace(Thread=NoThread), (503, "server_busy")),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            for _ in range(4):
                assert refusal(client.get("/v1/records?format=csv", headers=admin)) == code
        assert client.get("/v1/records?format=csv", headers=admin).status_code == 200


def test_third_export_at_once_or_one_without_room_on_the_disk_is_told_to_come_back(client, admin, export, monkeypatch):
    files = [export(), export()]
    assert refusal(client.get("/v1/records?format=csv", headers=admin)) == (503, "server_busy")
    for file in files:
        file.close()
    assert client.get("/v1/records?format=csv", headers=admin).status_code == 200
    monkeypatch.setattr("app.http.tables.spool.shutil.disk_usage", lambda _: type("Usage", (), {"free": -1}))
    assert refusal(client.get("/v1/records?format=csv", headers=admin)) == (503, "storage_full")
