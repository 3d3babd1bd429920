"""Pages of records: the caller's filters, keyset pages, opaque cursors that are bound to their filters."""

from app.db.session import Database
from app.http.paging import ID, INSTANT, Page, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.people.access.caller import Caller, visible_rows
from app.records import queries as records
from app.records.queries import RecordRow


def list_records(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[RecordRow]:
    """Return a page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = visible_rows(caller, chosen)
    listed = list_name("records", chosen)
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        rows = records.page_of_records(session, chosen, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.record.captured_at, row.record.item_id))
