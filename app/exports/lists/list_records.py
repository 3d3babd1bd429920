"""Records for a page: the caller's filters, keyset pages, an opaque cursor that binds its filters."""

import json
import uuid
from dataclasses import asdict, replace
from datetime import datetime

from app.db.session import Database
from app.http.cursors import ID, INSTANT, Page, decode_cursor, encode_cursor
from app.people.access.caller import Caller, DeviceCaller, visible_studies
from app.records import queries as records
from app.records.page_queries import RecordFilter
from app.records.queries import RecordRow


def list_records(
    database: Database, caller: Caller, chosen: RecordFilter, *, cursor: str | None, limit: int
) -> Page[RecordRow]:
    """One page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = visible_records(caller, chosen)
    after = decode_cursor(_listed(chosen), cursor, INSTANT, ID)
    with database.read() as session:
        rows = records.page_of_records(session, chosen, after=after, limit=limit + 1)
    if len(rows) <= limit:
        return Page(rows, None)
    last = rows[limit - 1].record
    return Page(rows[:limit], cursor_behind(chosen, last.captured_at, last.item_id))


def cursor_behind(visible: RecordFilter, captured_at: datetime, item_id: uuid.UUID) -> str:
    """The cursor of the page behind a place in the list, whether or not a record is there. visible: visible_records."""
    return encode_cursor(_listed(visible), captured_at, item_id)


def visible_records(caller: Caller, chosen: RecordFilter) -> RecordFilter:
    """Of these the ones that the caller may see: a phone its participant's only, staff those of their studies."""
    if isinstance(caller, DeviceCaller):
        return replace(chosen, participant_id=caller.participant_id)
    return replace(chosen, study_ids=visible_studies(caller))


def _listed(visible: RecordFilter) -> str:
    asked = asdict(replace(visible, study_ids=None))  # what the caller may see is no filter of theirs
    return "records " + json.dumps(asked, default=str, sort_keys=True)
