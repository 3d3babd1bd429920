"""The audit log as those who answer for a study read it: a study's by its owners, all of it by admins."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import datetime

from app.db.models import AuditEvent
from app.db.queries import privacy
from app.db.queries.privacy import AuditFilter
from app.db.session import Database
from app.services.caller import StaffCaller
from app.services.cursors import WHOLE_NUMBER, Page, decode_cursor, encode_cursor
from app.services.day_order import require_order
from app.services.studies import enter_study

STREAM_PAGE = 1000


@dataclass(frozen=True, slots=True)
class NamedEvent:
    """An event with its study's code; None: it is of no study, or of one that is not there."""

    event: AuditEvent
    study_code: str | None


def read_audit(
    database: Database,
    caller: StaffCaller,
    *,
    study_code: str | None,
    action: str | None,
    since: datetime | None,
    until: datetime | None,
    cursor: str | None,
    limit: int,
) -> Page[NamedEvent]:
    """A page of events, oldest first. study_code None: of all studies, for an admin.

    Raises NotFoundError, NotAllowedError, InvalidInputError for a cursor of other filters.
    """
    require_order(since, until)
    chosen = AuditFilter(action=action, since=since, until=until)
    with database.read() as session:
        if study_code is not None:
            study = enter_study(session, caller, study_code)
            chosen = replace(chosen, study_id=study.id)
        listed = "audit " + json.dumps(asdict(chosen), default=str, sort_keys=True)
        after = decode_cursor(listed, cursor, WHOLE_NUMBER)
        found = privacy.page_of_audit(session, chosen, after=after, limit=limit + 1)
        codes = privacy.study_codes(session)
    rows = [NamedEvent(event, codes.get(event.study_id) if event.study_id else None) for event in found[:limit]]
    return Page(rows, encode_cursor(listed, found[limit - 1].id) if len(found) > limit else None)


def stream_audit(
    database: Database,
    caller: StaffCaller,
    *,
    study_code: str | None,
    action: str | None,
    since: datetime | None,
    until: datetime | None,
) -> Iterator[NamedEvent]:
    """All events that the filters leave, a page's query at a time."""
    cursor = None
    while True:
        page = read_audit(
            database,
            caller,
            study_code=study_code,
            action=action,
            since=since,
            until=until,
            cursor=cursor,
            limit=STREAM_PAGE,
        )
        yield from page.rows
        cursor = page.cursor
        if cursor is None:
            return
