"""Read the audit log: owners that of their study, admins all of it."""

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
    is_newest_first: bool = False,
) -> Page[AuditRow]:
    """Return a page of events, the oldest first unless asked otherwise. study_code None: of all studies, for an admin.

    Raises NotFoundError, NotAllowedError, InvalidInputError for a cursor of another filter.
    """
    require_order(chosen.since, chosen.until)
    with database.read() as session:
        if study_code is not None:
            chosen = replace(chosen, study_id=enter_study(session, caller, study_code).id)
        list_name = f"audit {is_newest_first} " + json.dumps(
            asdict(chosen), default=str, sort_keys=True
        )
        after = decode_cursor(list_name, cursor, WHOLE_NUMBER)
        rows = privacy.page_of_audit(
            session, chosen, after=after, limit=limit + 1, is_newest_first=is_newest_first
        )
    return Page(
        rows[:limit], encode_cursor(list_name, rows[limit - 1].id) if len(rows) > limit else None
    )


def stream_audit(
    database: Database, caller: StaffCaller, study_code: str | None, chosen: AuditFilter
) -> Iterator[AuditRow]:
    """Stream all events that match the filter, a page per query."""
    cursor = None
    while True:
        page = read_audit(database, caller, study_code, chosen, cursor=cursor, limit=STREAM_PAGE)
        yield from page.rows
        cursor = page.cursor
        if cursor is None:
            return
