"""Statements compiled once for all databases of a worker's tests: each test's engines would compile them anew.

SQLAlchemy keeps compiled statements by engine and by dialect. Tests open a database each, of two dialects in all: here
dialects of a class are equal, and their engines keep what they compile in one place, which is emptied when it is full.
"""

from typing import Any, ClassVar

import sqlalchemy as sa
from sqlalchemy.dialects import registry
from sqlalchemy.dialects.postgresql.psycopg import PGDialect_psycopg
from sqlalchemy.dialects.sqlite.pysqlite import SQLiteDialect_pysqlite

MOST_STATEMENTS = 4000  # some 20 kB each


class Statements(dict[Any, Any]):
    """Compiled statements by SQLAlchemy's cache key, at most MOST_STATEMENTS."""

    def __setitem__(self, key: Any, compiled: Any) -> None:
        if len(self) >= MOST_STATEMENTS:
            self.clear()
        super().__setitem__(key, compiled)


class _Shared:
    supports_statement_cache = True
    statements: ClassVar[Statements]

    @classmethod
    def engine_created(cls, engine: sa.Engine) -> None:
        engine.update_execution_options(compiled_cache=cls.statements)

    def __eq__(self, other):
        return type(self) is type(other)

    def __hash__(self):
        return hash(type(self))


class SharedSqlite(_Shared, SQLiteDialect_pysqlite):
    supports_statement_cache = True
    statements: ClassVar[Statements] = Statements()


class SharedPostgres(_Shared, PGDialect_psycopg):
    supports_statement_cache = True
    statements: ClassVar[Statements] = Statements()


def share_statements() -> None:
    """Have all engines of this process that are made from now on share what they compile."""
    for name in ("sqlite", "sqlite.pysqlite"):
        registry.register(name, __name__, SharedSqlite.__name__)
    registry.register("postgresql.psycopg", __name__, SharedPostgres.__name__)
