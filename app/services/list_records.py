"""Records for a page or a stream: the caller's filters, keyset pages, an opaque cursor that binds its filters."""

import base64
import binascii
import hashlib
import json
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime

from app.db.queries import records
from app.db.queries.records import RecordFilter, RecordRow
from app.db.session import Database
from app.errors import InvalidInputError
from app.services.access import visible_studies
from app.services.caller import Caller, DeviceCaller

STREAM_PAGE = 1000  # rows a query while streaming: each its own short transaction


@dataclass(frozen=True, slots=True)
class Page:
    """Records, and the cursor of those behind them or None."""

    rows: list[RecordRow]
    cursor: str | None


def list_records(database: Database, caller: Caller, chosen: RecordFilter, *, cursor: str | None, limit: int) -> Page:
    """One page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = _visible(caller, chosen)
    after = _decode(cursor, chosen) if cursor else None
    with database.read() as session:
        rows = records.page_of_records(session, chosen, after=after, limit=limit + 1)
    if len(rows) <= limit:
        return Page(rows, None)
    last = rows[limit - 1].record
    return Page(rows[:limit], _encode((last.captured_at, last.item_id), chosen))


def stream_records(database: Database, caller: Caller, chosen: RecordFilter) -> Iterator[RecordRow]:
    """All records, a page's query at a time; memory stays that of a page."""
    cursor = None
    while True:
        page = list_records(database, caller, chosen, cursor=cursor, limit=STREAM_PAGE)
        yield from page.rows
        cursor = page.cursor
        if cursor is None:
            return


def _visible(caller: Caller, chosen: RecordFilter) -> RecordFilter:
    """A phone sees its participant's records only, staff those of their studies."""
    if isinstance(caller, DeviceCaller):
        return replace(chosen, participant_id=caller.participant_id)
    return replace(chosen, study_ids=visible_studies(caller))


def _fingerprint(chosen: RecordFilter) -> str:
    asked = asdict(replace(chosen, study_ids=None))  # what the caller may see is no filter of theirs
    return hashlib.sha256(json.dumps(asked, default=str, sort_keys=True).encode()).hexdigest()[:16]


def _encode(after: tuple[datetime, uuid.UUID], chosen: RecordFilter) -> str:
    value = [after[0].isoformat(), after[1].hex, _fingerprint(chosen)]
    return base64.urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


def _decode(cursor: str, chosen: RecordFilter) -> tuple[datetime, uuid.UUID]:
    try:
        captured_at, item_id, fingerprint = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        after = datetime.fromisoformat(captured_at).astimezone(UTC), uuid.UUID(item_id)
    except (ValueError, TypeError, AttributeError, binascii.Error, OverflowError):
        raise InvalidInputError(
            "The cursor is broken: follow `next` of the page before it.", code="cursor_invalid"
        ) from None
    if fingerprint != _fingerprint(chosen):
        raise InvalidInputError(
            "The cursor belongs to other filters: start again without it.", code="cursor_of_other_filters"
        )
    return after
