"""A table of a page as a file to keep: the rows that the page shows, in full."""

import re
from collections.abc import Sequence

from pydantic import BaseModel
from starlette.responses import Response

from app.http.tables.flat_rows import encode_flat, flat_paths
from app.http.tables.media_types import MEDIA_TYPES


def csv_file(model: type[BaseModel], rows: Sequence[BaseModel], name: str) -> Response:
    """Rows of a schema as CSV. name: of the file, without its ending; what no file name should hold becomes `-`."""
    told = [row.model_dump(mode="json", by_alias=True) for row in rows]
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    return Response(
        b"".join(encode_flat("csv", flat_paths(model, told), told)),
        media_type=MEDIA_TYPES["csv"],
        headers={"Content-Disposition": f'attachment; filename="{plain}.csv"'},
    )
