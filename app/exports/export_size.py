"""About how many rows an export would have, told beforehand: a long one is better made in the background."""

import uuid
from dataclasses import dataclass

from app.db.session import Database
from app.exports import size_queries as export_size
from app.exports.export_spec import ExportSpec
from app.records.page_queries import RecordFilter, search_of

MOST_COUNTED = 50_000  # an index is read along so far; a file of more rows takes longer than one waits
CHEAP = frozenset({"study_code", "participant_code", "first_day", "last_day"})


@dataclass(frozen=True, slots=True)
class RowsAbout:
    """How many rows of the wide layout, now; is_more: there are more than that."""

    count: int
    is_more: bool


def rows_about(database: Database, study_id: uuid.UUID, spec: ExportSpec) -> RowsAbout | None:
    """Rows by the filters that are cheap to count by; None: of days and photographs, and else, nobody knows."""
    filters = spec.filters
    chosen = RecordFilter(
        study_ids=frozenset({study_id}),
        participant_code=filters.participant_code,
        first_day=filters.first_day,
        last_day=filters.last_day,
        food_keys=filters.food_keys,
        statuses=filters.statuses,
    )
    with database.read() as session:
        if spec.rows == "items":
            search = search_of(session, chosen)
            count = export_size.count_records(session, search, MOST_COUNTED + 1) if search is not None else 0
        elif spec.rows == "meals" and not set(filters.set_names) - CHEAP:
            count = export_size.count_meals(session, study_id, chosen, MOST_COUNTED + 1)
        else:
            return None
    return RowsAbout(min(count, MOST_COUNTED), count > MOST_COUNTED)
