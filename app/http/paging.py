"""What every list takes and gives: `limit`, `cursor`, and `next` as a path that is followed as it stands."""

from typing import Annotated
from urllib.parse import urlencode

from fastapi import Query, Request

Limit = Annotated[int, Query(ge=1, le=1000, description="Rows in the answer, at most.")]
Cursor = Annotated[str | None, Query(max_length=600, description="From the page before: follow `next`.")]


def next_page(request: Request, cursor: str | None) -> str | None:
    """The path of the page behind this one; None: this is the last."""
    if cursor is None:
        return None
    others = [(key, value) for key, value in request.query_params.multi_items() if key != "cursor"]
    return f"{request.url.path}?{urlencode([*others, ('cursor', cursor)])}"
