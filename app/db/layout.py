"""The tables and columns of a schema at any revision, by name and plain type, alike for SQLite and PostgreSQL.

Read from an empty scratch database migrated to the revision, so that a backup can read a database that is not upgraded
yet, and distinguish our tables from others.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import sqlalchemy as sa

from app.db.base import UtcDateTime
from app.db.migrate import upgrade
from app.db.session import Database

ColumnType = Literal["uuid", "instant", "date", "json", "bytes", "float", "integer", "boolean", "text"]
# left out of backups: the schema's revision; leases; the key and the clock that were seen; sums, which are recomputed;
# exports, which can be requested again
TRANSIENT_TABLES = frozenset(
    {
        *("alembic_version", "worker_lease", "deployment", "export"),
        *("day_sum", "day_mark", "study_day_sum", "study_day_mark"),
    }
)


class RawJson(sa.types.UserDefinedType[str]):
    """JSON as the database's text: NULL and JSON's null stay distinct, and no number is rounded."""

    cache_ok = True

    def get_col_spec(self, **_: object) -> str:
        """Return a type for printed statements; no table is created with it."""
        return "JSON"

    def column_expression(self, colexpr: sa.ColumnElement[str]) -> sa.ColumnElement[str]:
        """Select the column as text."""
        return sa.cast(colexpr, sa.Text())


SQL_TYPES: dict[ColumnType, sa.types.TypeEngine[Any]] = {
    "uuid": sa.Uuid(),
    "instant": UtcDateTime(),
    "date": sa.Date(),
    "json": RawJson(),
    "bytes": sa.LargeBinary(),
    "float": sa.Double(),
    "integer": sa.BigInteger(),
    "boolean": sa.Boolean(),
    "text": sa.Text(),
}


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """A column's name, type, and whether it may be NULL."""

    name: str
    type: ColumnType
    is_nullable: bool


@dataclass(frozen=True, slots=True)
class TableLayout:
    """A table and its columns in order; key: the columns of its primary key."""

    name: str
    columns: tuple[ColumnLayout, ...]
    key: tuple[str, ...]

    def place(self, column: str) -> int | None:
        """Return the index of a column in a row; None: the table has no such column."""
        return next((place for place, layout in enumerate(self.columns) if layout.name == column), None)

    def table(self) -> sa.TableClause:
        """Return the table to select from and insert into, on either kind of database."""
        return sa.table(self.name, *(sa.column(column.name, SQL_TYPES[column.type]) for column in self.columns))


@cache
def layout_at(revision: str) -> tuple[TableLayout, ...]:
    """Return our tables at a known revision (schema_state.revisions), referenced tables first."""
    with tempfile.TemporaryDirectory(prefix="tada-layout-") as folder:
        scratch = Database(f"sqlite:///{Path(folder) / 'layout.sqlite3'}")
        try:
            upgrade(scratch, revision)
            metadata = sa.MetaData()
            metadata.reflect(scratch.read_engine)
        finally:
            scratch.dispose()
    return tuple(_layout_of(table) for table in metadata.sorted_tables if table.name not in TRANSIENT_TABLES)


def difference(connection: sa.Connection, layout: Sequence[TableLayout]) -> str | None:
    """Return how this database's columns differ from the layout, for the first such table; None: they do not."""
    inspector = sa.inspect(connection)
    existing = set(inspector.get_table_names())
    for table in layout:
        if table.name not in existing:
            return f"there is no table {table.name}"
        columns = {column["name"] for column in inspector.get_columns(table.name)}
        if columns != {column.name for column in table.columns}:
            return f"table {table.name} has other columns than its revision"
    return None


def _layout_of(table: sa.Table) -> TableLayout:
    return TableLayout(
        table.name,
        tuple(ColumnLayout(column.name, _type_of(column), bool(column.nullable)) for column in table.columns),
        tuple(column.name for column in table.primary_key.columns),
    )


def _type_of(column: sa.Column[Any]) -> ColumnType:
    """Return the type of a SQLite column created by a migration."""
    match column.type:
        case sa.CHAR(length=32):
            return "uuid"
        case sa.DateTime():
            return "instant"
        case sa.Date():
            return "date"
        case sa.JSON():
            return "json"
        case sa.LargeBinary():
            return "bytes"
        case sa.Boolean():
            return "boolean"
        case sa.Integer():
            return "integer"
        case sa.Numeric() | sa.Float():
            return "float"
        case sa.String():
            return "text"
        case other:
            raise TypeError(f"{column.table.name}.{column.name}: backups do not support {other!r}")
