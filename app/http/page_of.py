"""A page of a list as it is answered."""

from collections.abc import Callable
from typing import Generic, Self, TypeVar

from fastapi import Request
from pydantic import BaseModel, Field

from app.http.field_descriptions import NEXT, PAGE
from app.http.paging import Page, next_page

Row = TypeVar("Row")
Item = TypeVar("Item")


class PageOf(BaseModel, Generic[Item]):
    """Rows and the way to those behind them; each list has a subclass, whose name is the schema's."""

    items: list[Item] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)

    @classmethod
    def of(cls, request: Request, page: Page[Row], render: Callable[[Row], Item]) -> Self:
        """Render a page's rows, and the path of the page behind it."""
        return cls(items=[render(row) for row in page.rows], next=next_page(request, page.cursor))
