"""The data dictionary over the wire."""

from typing import Any

from pydantic import BaseModel, Field


class DictionaryColumn(BaseModel):
    """A column of a table."""

    position: int = Field(description="The column's place, 1 the first.")
    name: str
    type: str
    unit: str | None = Field(description="1: a share or a ratio; null: the values have none.")
    meaning: str
    values: list[str] = Field(description="All that there can be, where they are few.")
    empty: str | None = Field(description="What an empty cell (null) says; null: there is none.")


class DataDictionary(BaseModel):
    """A table's columns from left to right, and those that tell one row from all others."""

    rows: str
    layout: str
    components: str
    key: list[str]
    columns: list[DictionaryColumn]


class TableSchema(BaseModel):
    """Frictionless Data's Table Schema of the CSV file."""

    fields: list[dict[str, Any]]
    missingValues: list[str]  # noqa: N815  # named by the standard
    primaryKey: list[str]  # noqa: N815  # named by the standard
