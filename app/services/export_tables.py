"""Every table that leaves, one way: items, meals, days, photographs, by one spec; bytes of a file, of one moment.

Whoever exports for a person passes that person's caller: what they may not see is not in it. Used by requests
(export_file.py) and by whoever writes files in the background.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

from sqlalchemy.orm import Session

from app.db.queries.record_export import export_batches
from app.db.queries.record_pages import RecordFilter, search_of
from app.exports.columns import Batch, Part
from app.exports.csv_rows import encode_csv
from app.exports.geojson_rows import POINT, encode_geojson
from app.exports.ndjson_rows import encode_ndjson
from app.exports.record_columns import PROVENANCE_PARTS, RECORD_PARTS
from app.services.caller import Caller
from app.services.export_provenance import Provenance
from app.services.export_spec import ExportSpec, Output, check_spec
from app.services.list_records import visible_records

Counted = Callable[[int], None]


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
    parts, batches = _items(session, caller, spec)
    yield from encoded(spec.output, parts, _counting(batches, counted))


def encoded(output: Output, parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """Batches of these parts as a file; for GeoJSON each with the POINT behind them."""
    if output == "csv":
        return encode_csv(parts, batches)
    if output == "ndjson":
        return encode_ndjson(parts, batches)
    if output == "geojson":
        return encode_geojson(parts, batches)
    from app.exports.parquet_rows import encode_parquet  # noqa: PLC0415  # 60 MB, for those who ask for it

    return encode_parquet(parts, batches)


def _items(session: Session, caller: Caller, spec: ExportSpec) -> tuple[tuple[Part, ...], Iterable[Batch]]:
    filters = spec.filters
    chosen = RecordFilter(
        study_code=filters.study_code,
        participant_code=filters.participant_code,
        first_day=filters.first_day,
        last_day=filters.last_day,
        food_keys=filters.food_keys,
        statuses=filters.statuses,
    )
    search = search_of(session, visible_records(caller, chosen))
    parts: tuple[Part, ...] = (*RECORD_PARTS, *PROVENANCE_PARTS) if spec.provenance else RECORD_PARTS
    wanted = (*parts, POINT) if spec.output == "geojson" else parts
    if spec.provenance:
        return parts, export_batches(session, search, wanted, Provenance(session))
    return parts, export_batches(session, search, wanted)


def _counting(batches: Iterable[Batch], counted: Counted) -> Iterator[Batch]:
    for batch in batches:
        counted(len(batch[0].rows))
        yield batch
