"""Every value that a column can hold comes back the same: through its line of a backup, and through either database."""

import math
from datetime import UTC

import pytest
import sqlalchemy as sa
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from app.db.base import Base, UtcDateTime
from app.db.layout import SQL_TYPES, TRANSIENT_TABLES, ColumnLayout, TableLayout, layout_at
from app.db.schema_state import head_revision
from app.db.session import Database
from app.db.snapshot import Snapshot
from app.operations.backup.backup_values import row_reader, row_writer
from app.operations.backup.refill import Refill

TABLE = TableLayout("every_type", tuple(ColumnLayout(name, name, is_nullable=True) for name in SQL_TYPES), ("integer",))
COLUMN_OF = {
    "uuid": "CHAR(32)", "instant": "DATETIME", "date": "DATE", "json": "JSON", "bytes": "BLOB", "float": "DOUBLE",
    "integer": "BIGINT", "boolean": "BOOLEAN", "text": "TEXT",
}  # fmt: skip
ON_POSTGRES = COLUMN_OF | {
    "uuid": "UUID", "instant": "TIMESTAMPTZ", "json": "JSONB", "bytes": "BYTEA", "float": "DOUBLE PRECISION"
}  # fmt: skip
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30)
VALUES = {
    "uuid": st.uuids(),
    "instant": st.datetimes(timezones=st.just(UTC)),
    "date": st.dates(),
    "json": st.sampled_from(["null", "[]", '{"a": [1.5, null, "\\u00e4"]}', '{"n": 12345678901234567890123}']),
    "bytes": st.binary(max_size=30),
    "float": st.floats(allow_nan=False),
    "integer": st.integers(-(2**63), 2**63 - 1),
    "boolean": st.booleans(),
    "text": TEXTS | st.sampled_from(["", "NaN", "\\N", "a\tb\nc\\", "'\";--", "\u2028", "😀", '{"a"'])
}  # fmt: skip
ROWS = st.tuples(*(st.none() | VALUES[column.name] for column in TABLE.columns))


@given(row=ROWS)
@settings(max_examples=200, derandomize=True, deadline=None)
def test_row_comes_back_from_its_line_as_it_was(row):
    line = row_writer(TABLE)(row)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert tuple(row_reader(TABLE)(line)) == row


def test_floats_that_are_easily_rounded_come_back_exactly():
    for value in (math.inf, -math.inf, 5e-324, 1.7976931348623157e308, 0.1 + 0.2, 2**53 + 1.0):
        assert through_a_line("float", value) == [value]
    assert math.isnan(through_a_line("float", math.nan)[0])


def test_value_that_is_not_of_its_column_cannot_be_written():
    for column, value in (("integer", True), ("integer", 1.0), ("float", "1"), ("text", b"x")):
        with pytest.raises(TypeError):
            through_a_line(column, value)


def through_a_line(column, value):
    """The row of one value, written and read back."""
    table = TableLayout("t", (ColumnLayout("x", column, is_nullable=False),), ("x",))
    return row_reader(table)(row_writer(table)([value]))


@pytest.fixture
def filled(database_url):
    """From rows to the rows that the database gives back, through Refill and Snapshot."""
    database = Database(database_url)
    types = COLUMN_OF if database.is_sqlite else ON_POSTGRES
    columns = ", ".join(f'"{column.name}" {types[column.type]}' for column in TABLE.columns)
    with database.write() as session:
        session.execute(sa.text(f"CREATE TABLE every_type ({columns})"))

    def through(rows):
        with database.write() as session:
            session.execute(sa.text("DELETE FROM every_type"))
            assert Refill(session.connection()).put(TABLE, rows) == len(rows)
        with database.read() as session:
            return list(map(tuple, Snapshot(session.connection()).rows(TABLE)))

    yield through
    database.dispose()


@pytest.mark.both_stores
@given(rows=st.lists(ROWS, min_size=1, max_size=20))
@example(rows=[(None,) * len(TABLE.columns)])
@settings(max_examples=25, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_rows_come_back_from_the_database_as_they_were(kind, filled, rows):
    place = TABLE.place("json")
    back = filled(rows)
    assert [but(row, place) for row in back] == [but(row, place) for row in rows]
    for told, given_row in zip(back, rows, strict=True):
        assert (told[place] is None) == (given_row[place] is None)  # NULL is not JSON's null
        if kind == "sqlite":
            assert told[place] == given_row[place]  # its own text; PostgreSQL spaces it in its own way


def but(row, place):
    return row[:place] + row[place + 1 :]


def test_layout_is_that_of_the_models():
    """Asked of a scratch database it names every table and column that there is, and what kind of value it holds."""
    kinds = {
        sa.Uuid: "uuid", UtcDateTime: "instant", sa.Date: "date", sa.JSON: "json", sa.LargeBinary: "bytes",
        sa.Float: "float", sa.Boolean: "boolean", sa.Integer: "integer", sa.String: "text",
    }  # fmt: skip
    modelled = {
        (table.name, column.name): next(kind for type_, kind in kinds.items() if isinstance(column.type, type_))
        for table in Base.metadata.sorted_tables
        for column in table.columns
        if table.name not in TRANSIENT_TABLES
    }
    found = {(t.name, column.name): column.type for t in layout_at(head_revision()) for column in t.columns}
    assert found == modelled
