"""The schema of a page of a list."""

from typing import Generic, TypeVar

from pydantic import BaseModel, Field

from app.http.field_descriptions import NEXT, PAGE

Row = TypeVar("Row")


class PageOf(BaseModel, Generic[Row]):
    """Rows and the way to those behind them; each list has a subclass, whose name is the schema's."""

    items: list[Row] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)
