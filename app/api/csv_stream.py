"""Rows as CSV, some at a time (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice

from fastapi.responses import StreamingResponse

from app.exports.csv_rows import safe_cell

ROWS_A_CHUNK = 200


def csv_response(name: str, columns: Sequence[str], rows: Iterator[Mapping[str, object]]) -> StreamingResponse:
    """A file of this name. The first row is read at once: a database that fails gives an error, not a broken file."""
    first = list(islice(rows, 1))
    return StreamingResponse(
        stream_csv(columns, chain(first, rows)),
        media_type="text/csv; charset=utf-8; header=present",
        headers={"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"},
    )


def stream_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> Iterator[str]:
    """Header and rows."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(columns)
    left = iter(rows)
    while True:
        chunk = list(islice(left, ROWS_A_CHUNK))
        writer.writerows([safe_cell(row[name]) for name in columns] for row in chunk)
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
        if len(chunk) < ROWS_A_CHUNK:
            return
