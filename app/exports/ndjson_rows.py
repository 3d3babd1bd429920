"""Batches as NDJSON: an object a line, as a JSON page has them but for the food, which is food_key and food_name."""

import json
from collections.abc import Iterable, Iterator, Sequence

from app.exports.record_columns import Batch, Column


def encode_ndjson(columns: Sequence[Column], batches: Iterable[Batch]) -> Iterator[bytes]:
    """Each batch's rows; nothing at all of no rows."""
    names = [column.name for column in columns]
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode
    for batch in batches:
        lines = [encode(dict(zip(names, row, strict=True))) for row in zip(*batch, strict=True)]
        yield ("\n".join(lines) + "\n").encode() if lines else b""
