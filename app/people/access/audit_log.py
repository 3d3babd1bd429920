"""The audit log as those who answer for a study read it: a study's by its owners, all of it by admins."""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace

from app.db.session import Database
from app.http.paging import WHOLE_NUMBER, Page, decode_cursor, encode_cursor, require_order
from app.people import privacy_queries as privacy
from app.people.access.caller import StaffCaller
from app.people.privacy_queries import AuditFilter, AuditRow
from app.people.studies import enter_study

STREAM_PAGE = 1000


def read_audit(
    database: Database,
    caller: StaffCaller,
    study_code: str | None,
    chosen: AuditFilter,
    *,
    cursor: str | None,
    limit: int,
) -> Page[AuditRow]:
    """A page of events, oldest first. study_code None: of all studies, for an admin.

    Raises NotFoundError, NotAllowedError, InvalidInputError for a cursor of other filters.
    """
    require_order(chosen.since, chosen.until)
    with database.read() as session:
        if study_code is not None:
            chosen = replace(chosen, study_id=enter_study(session, caller, study_code).id)
        listed = "audit " + json.dumps(asdict(chosen), default=str, sort_keys=True)
        after = decode_cursor(listed, cursor, WHOLE_NUMBER)
        rows = privacy.page_of_audit(session, chosen, after=after, limit=limit + 1)
    return Page(rows[:limit], encode_cursor(listed, rows[limit - 1].id) if len(rows) > limit else None)


def stream_audit(
    database: Database, caller: StaffCaller, study_code: str | None, chosen: AuditFilter
) -> Iterator[AuditRow]:
    """All events that the filters leave, a page's query at a time."""
    cursor = None
    while True:
        page = read_audit(database, caller, study_code, chosen, cursor=cursor, limit=STREAM_PAGE)
        yield from page.rows
        cursor = page.cursor
        if cursor is None:
            return
