"""How many rows an export will have, about: asked once at its beginning, so that a reader sees how far it is."""

import uuid

from sqlalchemy.orm import Session

from app.exports import queries as exports
from app.exports.export_spec import ExportSpec
from app.records.page_queries import RecordFilter, search_of


def estimate_rows(session: Session, study_id: uuid.UUID, spec: ExportSpec) -> int | None:
    """Rows of the wide layout by the filters that are cheap to count by; None: nobody knows."""
    filters = spec.filters
    if spec.layout == "long":
        return None
    if spec.rows == "items":
        search = search_of(
            session,
            RecordFilter(
                study_ids=frozenset({study_id}),
                participant_code=filters.participant_code,
                first_day=filters.first_day,
                last_day=filters.last_day,
                food_keys=filters.food_keys,
                statuses=filters.statuses,
            ),
        )
        return exports.count_found(session, search)
    if set(filters.set_names) - {"study_code", "participant_code", "first_day", "last_day"}:
        return None
    return exports.count_rows(
        session, study_id, spec.rows, filters.participant_code, filters.first_day, filters.last_day
    )
