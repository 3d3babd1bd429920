"""Rows as CSV, some at a time (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice

from app.exports.csv_rows import safe_cell

ROWS_A_CHUNK = 200
MEDIA_TYPE = "text/csv; charset=utf-8; header=present"


def stream_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> Iterator[bytes]:
    """Header and rows."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(columns)
    left = iter(rows)
    while True:
        chunk = list(islice(left, ROWS_A_CHUNK))
        writer.writerows([safe_cell(row[name]) for name in columns] for row in chunk)
        yield buffer.getvalue().encode()
        buffer.seek(0)
        buffer.truncate()
        if len(chunk) < ROWS_A_CHUNK:
            return
