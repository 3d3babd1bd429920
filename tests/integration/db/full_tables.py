"""A database with a row in every table, and its rows."""

import re
import uuid
from datetime import UTC, date, datetime

import sqlalchemy as sa

from app.db.base import Base

ONE = uuid.UUID(int=1)  # the id of every row
VOLUME = {"volume_ml": 185.0, "volume_low_ml": 180.0, "volume_high_ml": 190.0}
ALSO = {
    "access_token": {"staff_id": ONE},  # somebody's
    "item": VOLUME | {"run_id": ONE},  # found by a run
    "effective_record": VOLUME,
    "camera_calibration": {"marker": "plain:9x7:11", "rms_px": 0.2, "photographs": 9},  # no rig
    "run": {"marker": "plain:9x7:11"},  # not by a rig
    "study": {"is_sandbox": False},
    "leftover": {"item_id": ONE},  # matched
}
VALUES = {
    str: "x",
    int: 1,
    float: 1.0,
    bool: True,
    bytes: b"x",
    object: {},  # JSON
    uuid.UUID: ONE,
    date: date(2026, 11, 21),
    datetime: datetime(2026, 11, 21, tzinfo=UTC),
}


ONE_OF = re.compile(r"(?P<column>\w+) IN \('(?P<first>\w+)'")


def fill_tables(database):
    """A row in each table, with references to the others' rows."""
    with database.write() as session:
        for table in Base.metadata.sorted_tables:
            if table.name == "deployment":  # the migration made its only row
                continue
            values = {column.name: fitting(session, column) for column in table.columns if is_needed(column)}
            values |= ALSO.get(table.name, {})
            session.execute(sa.insert(table).values(values))


def is_needed(column):
    return not column.nullable and column.default is None and column.autoincrement is not True


def fitting(session, column):
    for key in column.foreign_keys:
        return session.execute(sa.select(key.column).limit(1)).scalar_one()
    for check in column.table.constraints:
        words = ONE_OF.match(str(check.sqltext)) if isinstance(check, sa.CheckConstraint) else None
        if words and words["column"] == column.name:
            return words["first"]
    plain = column.type.impl if isinstance(column.type, sa.types.TypeDecorator) else column.type
    return VALUES[plain.python_type]


def rows_of(database):
    """Table -> its rows, of our own tables."""
    with database.read() as session:
        schema = sa.MetaData()
        schema.reflect(session.connection(), only=lambda name, _: name in Base.metadata.tables)
        return {
            table.name: [dict(row) for row in session.execute(sa.select(table)).mappings()]
            for table in schema.sorted_tables
        }


def shared(rows, columns):
    return sorted(repr([row[name] for name in columns]) for row in rows)


def assert_survived(before, after):
    """In the tables and columns that both have."""
    for table in before.keys() & after.keys():
        columns = sorted(before[table][0].keys() & after[table][0].keys()) if before[table] and after[table] else []
        assert len(before[table]) == len(after[table]), table
        assert shared(before[table], columns) == shared(after[table], columns), table
