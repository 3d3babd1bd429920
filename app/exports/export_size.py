"""The number of rows of an export, for filters by which counting is cheap."""

import uuid
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.db.session import Database
from app.exports import queries as exports
from app.exports.export_spec import FILTERS, ExportSpec
from app.records.page_queries import search_of

MOST_COUNTED = 50_000  # rows read from an index; a file of more rows takes too long to wait for


@dataclass(frozen=True, slots=True)
class RowCount:
    """The current number of rows of the wide layout; is_more: there are more."""

    count: int
    is_more: bool


def count_export_rows(database: Database, study_id: uuid.UUID, spec: ExportSpec) -> RowCount | None:
    """Return the number of rows of a file of items or meals, so that a long one is made in the background."""
    if spec.rows not in ("items", "meals"):
        return None
    with database.read() as session:
        count = estimate_rows(session, study_id, replace(spec, layout="wide"), MOST_COUNTED + 1)
    return RowCount(min(count, MOST_COUNTED), count > MOST_COUNTED) if count is not None else None


def estimate_rows(
    session: Session, study_id: uuid.UUID, spec: ExportSpec, most: int | None = None
) -> int | None:
    """Return the number of rows, counted up to `most`; None for the long layout, participants, and other filters."""
    if spec.layout == "long" or spec.rows == "participants":
        return None
    if spec.rows == "items":
        chosen = replace(spec.filters, study_code=None, study_ids=frozenset({study_id}))
        return exports.count_records(session, search_of(session, chosen), most)
    if set(spec.filters.set_names) - set(FILTERS["days"]):
        return None
    return exports.count_rows(session, study_id, spec.rows, spec.filters, most)
