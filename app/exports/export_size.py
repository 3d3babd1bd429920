"""About how many rows an export has, by the filters that are cheap to count by."""

import uuid
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.db.session import Database
from app.exports import queries as exports
from app.exports.export_spec import FILTERS, ExportSpec
from app.records.page_queries import search_of

MOST_COUNTED = 50_000  # an index is read along so far; a file of more rows takes longer than one waits


@dataclass(frozen=True, slots=True)
class RowsAbout:
    """How many rows of the wide layout, now; is_more: there are more than that."""

    count: int
    is_more: bool


def rows_about(database: Database, study_id: uuid.UUID, spec: ExportSpec) -> RowsAbout | None:
    """Return how many rows a file of items or meals has, so that a long one is made in the background."""
    if spec.rows not in ("items", "meals"):
        return None
    with database.read() as session:
        count = estimate_rows(session, study_id, replace(spec, layout="wide"), MOST_COUNTED + 1)
    return RowsAbout(min(count, MOST_COUNTED), count > MOST_COUNTED) if count is not None else None


def estimate_rows(session: Session, study_id: uuid.UUID, spec: ExportSpec, most: int | None = None) -> int | None:
    """Return the number of rows, counted up to `most`; None: of the long layout and other filters it is not known."""
    if spec.layout == "long":
        return None
    if spec.rows == "items":
        chosen = replace(spec.filters, study_code=None, study_ids=frozenset({study_id}))
        return exports.count_records(session, search_of(session, chosen), most)
    if set(spec.filters.set_names) - set(FILTERS["days"]):
        return None
    return exports.count_rows(session, study_id, spec.rows, spec.filters, most)
