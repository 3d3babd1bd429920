"""Rows as files: every text reads back, and what a spreadsheet would compute is none."""

import csv
import io
import json

import pyarrow.parquet as pq
import pytest

from app.exports.live_tables import limited_duckdb
from app.exports.table_selects import TableSelect
from app.exports.write_table import write_table
from app.http.columns.dictionary import Column
from app.http.flat_list import FORMULA_STARTS

COLUMNS = (
    Column("id", "id"),
    Column("name", "word"),
    Column("flags", "words"),
    Column("is_new", "boolean"),
    Column("eaten_at", "instant"),
    Column("local", "local time"),
    Column("day", "day"),
    Column("grams", "number"),
    Column("count", "integer"),
)
ROWS = """
SELECT * FROM (VALUES
    ('y', NULL, []::VARCHAR[], NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL),
    ('x', 'größe', ['a', 'b'], true, TIMESTAMPTZ '2026-11-27 12:00:00+00', TIMESTAMP '2026-11-27 13:00:00.5',
     DATE '2026-11-27', 1e22, 3, 16.4, 48.2)
) t(id, name, flags, is_new, eaten_at, local, day, grams, count, longitude, latitude)
"""


@pytest.fixture
def write(tmp_path):
    def write(output, columns=COLUMNS, sql=ROWS, order="id"):
        path = tmp_path / f"table.{output}"
        with limited_duckdb(tmp_path) as connection:
            connection.execute("SET TimeZone = 'UTC'")
            count = write_table(connection, TableSelect(columns, sql, order), output, path)
        return count, path.read_bytes()

    return write


def test_each_format_has_the_rows_in_their_order_with_instants_as_json_has_them(write):
    count, lines = write("ndjson")
    rows = [json.loads(line) for line in lines.splitlines()]
    assert count == 2
    assert rows == [
        {
            "id": "x",
            "name": "größe",
            "flags": ["a", "b"],
            "is_new": True,
            "eaten_at": "2026-11-27T12:00:00Z",
            "local": "2026-11-27T13:00:00.500000",
            "day": "2026-11-27",
            "grams": 1e22,
            "count": 3,
        },
        {"id": "y", "flags": []} | dict.fromkeys(["name", "is_new", "eaten_at", "local", "day", "grams", "count"]),
    ]
    _, text = write("csv")
    assert text.endswith(b"\r\ny,,,,,,,,\r\n")
    assert b"x,gr\xc3\xb6\xc3\x9fe,a b,True,2026-11-27T12:00:00Z,2026-11-27T13:00:00.500000,2026-11-27,1e+22,3" in text
    _, features = write("geojson")
    points = [feature["geometry"] for feature in json.loads(features)["features"]]
    assert points == [{"type": "Point", "coordinates": [16.4, 48.2]}, None]
    _, parquet = write("parquet")
    table = pq.read_table(io.BytesIO(parquet))
    assert table["flags"].to_pylist() == [["a", "b"], []]
    assert str(table.schema.field("eaten_at").type) == "timestamp[us, tz=UTC]"


TEXTS = ["line\nfeed", "carriage\rreturn", "a,b", 'a "quoted" word', " blank ", "größe", ""]


@pytest.mark.parametrize("text", [*TEXTS, *(f"{start}1+2" for start in FORMULA_STARTS)])
def test_text_of_a_csv_cell_reads_back_and_is_no_formula(write, text):
    column = (Column("text", "word"), Column("words", "words"))
    sql = f"SELECT {quote(text)} AS text, [{quote(text)}] AS words"
    _, file = write("csv", column, sql, "text")
    safe = f"'{text}" if text.startswith(FORMULA_STARTS) else text
    rows = list(csv.reader(io.StringIO(file.decode(), newline="")))
    assert rows == [["text", "words"], [safe, safe]]


def quote(text):
    return "'" + text.replace("'", "''") + "'"
