"""The declarative base: names of constraints by convention, aware UTC times, JSON."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql
from sqlalchemy.orm import DeclarativeBase

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}


class UtcDateTime(sa.types.TypeDecorator[datetime]):
    """An instant: aware in Python, UTC in the database; a naive datetime is refused."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Convert an aware datetime to UTC (SQLite stores no time zone)."""
        del dialect
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("a naive datetime is not an instant")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Return the database's UTC time as an aware datetime."""
        del dialect
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


JsonValue = sa.JSON(none_as_null=True).with_variant(
    postgresql.JSONB(none_as_null=True), "postgresql"
)


@dataclass(frozen=True, slots=True)
class Personal:
    """How a table's rows belong to a participant, for erasures and a participant's own export (privacy/queries.py).

    through: columns whose foreign keys lead to a meal or a participant. export_as: name in the
    export; None: not exported. order_by: column.
    """

    through: tuple[str, ...]
    export_as: str | None = None
    order_by: str | None = None


@dataclass(frozen=True, slots=True)
class BlobColumns:
    """Columns that reference a blob.

    erased_at: column set when the blob is to be deleted; None: the row is deleted.
    """

    key: str = "blob_key"
    erased_at: str | None = None


class Base(DeclarativeBase):
    """Base of all tables."""

    personal: ClassVar[Personal | None] = None
    blob: ClassVar[BlobColumns | None] = None

    metadata = sa.MetaData(naming_convention=NAMING)
    type_annotation_map = {  # noqa: RUF012  # SQLAlchemy's own form
        datetime: UtcDateTime(),
        dict[str, Any]: JsonValue,
        dict[str, str]: JsonValue,
        dict[str, float]: JsonValue,
        dict[str, int]: JsonValue,
        dict[str, object]: JsonValue,
        dict[str, list[object]]: JsonValue,
        list[Any]: JsonValue,
        list[str]: JsonValue,
        list[list[float]]: JsonValue,
    }


def one_of(column: str, values: tuple[str, ...]) -> sa.CheckConstraint:
    """Return a check that a text column has one of these values."""
    listed = ", ".join(f"'{value}'" for value in values)
    return sa.CheckConstraint(f"{column} IN ({listed})", name=column)


def index_where(name: str | None, *columns: str, where: str, unique: bool = False) -> sa.Index:
    """Return an index of the rows for which a condition holds.

    where: the condition, with {yes} and {no} for booleans
    """
    return sa.Index(
        name,
        *columns,
        unique=unique,
        sqlite_where=sa.text(where.format(yes=1, no=0)),
        postgresql_where=sa.text(where.format(yes="true", no="false")),
    )
