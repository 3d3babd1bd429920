"""A page's table as a CSV file."""

import re
from collections.abc import Sequence

from pydantic import BaseModel
from starlette.responses import Response

from app.http.file_formats import FORMATS
from app.http.flat_rows import encode_flat, flat_paths


def csv_file(model: type[BaseModel], rows: Sequence[BaseModel], name: str) -> Response:
    """Return rows of a schema as CSV. name: the file's, without its extension; unsafe characters become `-`."""
    records = [row.model_dump(mode="json", by_alias=True) for row in rows]
    safe_name = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    return Response(
        b"".join(encode_flat("csv", flat_paths(model, records), records)),
        media_type=FORMATS["csv"].media_type,
        headers={"Content-Disposition": f'attachment; filename="{safe_name}.csv"'},
    )
