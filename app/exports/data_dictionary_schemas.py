"""Schemas of the data dictionary."""

from typing import Any

from pydantic import BaseModel, Field

from app.exports.export_spec import Components, Layout, Rows
from app.http.columns.dictionary import DictionaryType


class DictionaryColumn(BaseModel):
    """A column of a table."""

    position: int = Field(description="The column's place, 1 the first.")
    name: str = Field(description="The column's name in CSV, Parquet and NDJSON files.")
    type: DictionaryType = Field(
        description="The type of the values. An instant is RFC 3339, a local time is without offset, a day YYYY-MM-DD."
    )
    unit: str | None = Field(description="1: a share or a ratio; null: the values have none.")
    meaning: str = Field(description="What the value means.")
    values: list[str] = Field(description="All possible values, if there are few.")
    empty: str | None = Field(
        description="What an empty cell (null) means; null: no cell is empty."
    )


class DataDictionary(BaseModel):
    """A table's columns from left to right, and its key."""

    rows: Rows = Field(description="The table: items, meals, days, photographs or participants.")
    layout: Layout = Field(
        description="wide: one column per component. long: one row per component."
    )
    components: Components = Field(
        description="headline: the ten components of every record. all: every component of the food tables as well."
    )
    key: list[str] = Field(description="Names of the columns that together identify a row.")
    columns: list[DictionaryColumn] = Field(description="The columns from left to right.")


class TableSchema(BaseModel):
    """Frictionless Data's Table Schema of the CSV file."""

    fields: list[dict[str, Any]] = Field(
        description="One Frictionless field descriptor per column, from left to right."
    )
    missingValues: list[str] = Field(description="Cells that stand for an unknown value.")  # noqa: N815  # named by the standard
    primaryKey: list[str] = Field(description="Names of the columns that together identify a row.")  # noqa: N815  # named by the standard
