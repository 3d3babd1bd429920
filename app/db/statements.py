"""Parts of statements: types of columns that are chosen at run time, and ids and days as text."""

from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

AnyColumn = sa.ColumnElement[Any] | InstrumentedAttribute[Any]
AnyQuery = sa.Select[*tuple[Any, ...]]
Condition = sa.ColumnElement[bool]
Conditions = tuple[Condition, ...]


class stored_text(FunctionElement[str]):  # noqa: N801  # named as the SQL function that it stands for
    """An id or day as the text that the database makes fastest.

    Ids have hyphens on PostgreSQL and none on SQLite; days are ISO dates on both.
    """

    type = sa.String()
    inherit_cache = True


@compiles(stored_text, "postgresql")
def _text_postgresql(element: stored_text, compiler: SQLCompiler, **options: Any) -> str:
    return f"CAST({compiler.process(element.clauses, **options)} AS TEXT)"


@compiles(stored_text, "sqlite")
def _text_sqlite(element: stored_text, compiler: SQLCompiler, **options: Any) -> str:
    return compiler.process(element.clauses, **options)
