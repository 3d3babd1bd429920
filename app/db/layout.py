"""Which tables and columns a schema has, by name and plain type: the same for SQLite and PostgreSQL, for any revision.

Asked of an empty scratch database that is brought to the revision: so a backup reads a database that is not upgraded
yet, and knows our tables from others that stand beside them.
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
# the schema's own; claims to be alive now; what is counted anew from the rest; files that are made again for the asking
OF_NO_WORTH_LATER = frozenset(
    {"alembic_version", "worker_lease", "day_sum", "day_mark", "study_day_sum", "study_day_mark", "export"}
)


class RawJson(sa.types.UserDefinedType[str]):
    """JSON as the text that the database keeps: NULL and JSON's null stay apart, and no number is rounded."""

    cache_ok = True

    def get_col_spec(self, **_: object) -> str:
        """Only for statements that are printed: no table is made with it."""
        return "JSON"

    def column_expression(self, colexpr: sa.ColumnElement[str]) -> sa.ColumnElement[str]:
        """As text."""
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
    """A column's name, what kind of value it holds, and whether it may be NULL."""

    name: str
    type: ColumnType
    is_nullable: bool


@dataclass(frozen=True, slots=True)
class TableLayout:
    """A table and its columns in their order; key: the columns of its primary key."""

    name: str
    columns: tuple[ColumnLayout, ...]
    key: tuple[str, ...]

    def place(self, column: str) -> int | None:
        """Which value of a row is this column's; None: the table has no such column."""
        return next((place for place, one in enumerate(self.columns) if one.name == column), None)

    def table(self) -> sa.TableClause:
        """To select from and insert into, on either kind of database."""
        return sa.table(self.name, *(sa.column(one.name, SQL_TYPES[one.type]) for one in self.columns))


@cache
def layout_at(revision: str) -> tuple[TableLayout, ...]:
    """Our tables at a revision that this code knows (migrate.revisions), those that are referred to first."""
    with tempfile.TemporaryDirectory(prefix="tada-layout-") as folder:
        scratch = Database(f"sqlite:///{Path(folder) / 'layout.sqlite3'}")
        try:
            upgrade(scratch, revision)
            metadata = sa.MetaData()
            metadata.reflect(scratch.read_engine)
        finally:
            scratch.dispose()
    return tuple(_layout_of(table) for table in metadata.sorted_tables if table.name not in OF_NO_WORTH_LATER)


def difference(connection: sa.Connection, layout: Sequence[TableLayout]) -> str | None:
    """The first table whose columns in this database are not those of the layout, in words; None: all are."""
    inspector = sa.inspect(connection)
    there = set(inspector.get_table_names())
    for table in layout:
        if table.name not in there:
            return f"there is no table {table.name}"
        columns = {column["name"] for column in inspector.get_columns(table.name)}
        if columns != {column.name for column in table.columns}:
            return f"table {table.name} has other columns than its revision"
    return None


def _layout_of(table: sa.Table) -> TableLayout:
    return TableLayout(
        table.name,
        tuple(ColumnLayout(one.name, _type_of(one), bool(one.nullable)) for one in table.columns),
        tuple(one.name for one in table.primary_key.columns),
    )


def _type_of(column: sa.Column[Any]) -> ColumnType:
    """What a column of SQLite that a migration made is for."""
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
            raise TypeError(f"{column.table.name}.{column.name}: no backup is known of {other!r}")
