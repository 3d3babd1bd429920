"""Every table that leaves, one way, by one spec: items, meals, days, photographs, participants; as a file's bytes.

Whoever exports for a person passes that person's caller: what they may not see is not in it. Used by requests
(export_file.py) and by whoever writes files in the background.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from sqlalchemy.orm import Session

from app.exports.export_spec import ExportSpec, Rows, check_spec
from app.exports.tables.export_days import day_table
from app.exports.tables.export_items import item_table
from app.exports.tables.export_meals import meal_table, photograph_table
from app.exports.tables.export_participants import participant_table
from app.exports.tables.export_table import Table
from app.http.tables.columns import Batch, Part
from app.http.tables.csv_rows import encode_csv
from app.http.tables.geojson_rows import encode_geojson
from app.http.tables.media_types import Output
from app.http.tables.ndjson_rows import encode_ndjson
from app.people.access.caller import Caller

Counted = Callable[[int], None]
TABLES: Mapping[Rows, Callable[[Session, Caller, ExportSpec], Table]] = {
    "items": item_table,
    "meals": meal_table,
    "days": day_table,
    "photographs": photograph_table,
    "participants": participant_table,
}


def write_export(
    session: Session, caller: Caller, spec: ExportSpec, *, counted: Counted = lambda _: None
) -> Iterator[bytes]:
    """The file's pieces; read in the session's one transaction as they are asked for, memory that of a batch.

    counted: told how many rows each further batch has, before its bytes come. The same data gives the same bytes.
    Raises InvalidInputError (`export_not_offered`, `days_reversed`) at once.
    """
    check_spec(spec)
    return _written(session, caller, spec, counted)


def _written(session: Session, caller: Caller, spec: ExportSpec, counted: Counted) -> Iterator[bytes]:
    table = table_of(session, caller, spec)
    yield from encoded(spec.output, table.parts, _counting(table.batches, counted))


def table_of(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """The table: its columns are there at once, its rows are read as they are asked for."""
    return TABLES[spec.rows](session, caller, spec)


def encoded(output: Output, parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """Batches of these parts as a file; for GeoJSON each with the POINT behind them."""
    if output == "csv":
        return encode_csv(parts, batches)
    if output == "ndjson":
        return encode_ndjson(batches)
    if output == "geojson":
        return encode_geojson(batches)
    from app.http.tables.parquet_rows import encode_parquet  # noqa: PLC0415  # 60 MB, for those who ask for it

    return encode_parquet(parts, batches)


def _counting(batches: Iterable[Batch], counted: Counted) -> Iterator[Batch]:
    for batch in batches:
        counted(len(batch[0]))
        yield batch
