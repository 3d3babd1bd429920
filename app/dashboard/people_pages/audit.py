"""The audit log: of a study for its owners, of everything for admins."""

import uuid
from collections.abc import Iterable
from datetime import UTC, date, datetime, time, timedelta
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.dashboard.page import CurrentPage, Page
from app.db.session import Database
from app.http.paging import Cursor
from app.http.parameters import FirstDay, LastDay
from app.people.access.audit_api import audit_file, read_audit
from app.people.access.page_rules import PREFIX
from app.people.privacy_queries import AuditFilter
from app.privacy import queries as privacy

router = APIRouter(include_in_schema=False)

EVENTS_A_PAGE = 100

Action = Annotated[str, Query(max_length=64)]
Output = Annotated[str, Query(alias="format", max_length=8)]


def names_of_aliases(database: Database, texts: Iterable[str | None]) -> dict[str, str]:
    """Return alias -> a participant's code, or a meal's participant and local day; other texts are left out."""
    aliases = {alias for text in texts if text and (alias := _id_of(text))}
    with database.read() as session:
        people, meals = (
            privacy.participants_by_alias(session, aliases),
            privacy.meals_by_alias(session, aliases),
        )
    return people | {alias: f"{code}, {local_date}" for alias, (code, local_date) in meals.items()}


def _id_of(text: str) -> uuid.UUID | None:
    try:
        return uuid.UUID(text)
    except ValueError:
        return None


@router.get(f"{PREFIX}/studies/{{study}}/audit")
def get_study_audit(
    page: CurrentPage,
    study: str,
    action: Action = "",
    first: FirstDay = None,
    last: LastDay = None,
    cursor: Cursor = None,
    output: Output = "",
) -> Response:
    """The audit log of a study."""
    return _audit(page, study, action, first, last, cursor, output)


@router.get(f"{PREFIX}/audit")
def get_audit(
    page: CurrentPage,
    action: Action = "",
    first: FirstDay = None,
    last: LastDay = None,
    cursor: Cursor = None,
    output: Output = "",
) -> Response:
    """The audit log of the whole server."""
    return _audit(page, None, action, first, last, cursor, output)


def _audit(
    page: Page,
    study: str | None,
    action: str,
    first: date | None,
    last: date | None,
    cursor: str | None,
    output: str,
) -> Response:
    """first, last: UTC days, as the log's times are shown; both included."""
    chosen = AuditFilter(
        action=action or None,
        since=_midnight(first) if first is not None else None,
        until=_midnight(last + timedelta(days=1)) if last is not None else None,
    )
    if output == "csv":
        return audit_file(page.state, page.caller, study, chosen)
    database = page.database
    events = read_audit(
        database,
        page.caller,
        study,
        chosen,
        cursor=cursor,
        limit=EVENTS_A_PAGE,
        is_newest_first=True,
    )
    return page.render(
        "audit.html",
        rows=events.rows,
        names=names_of_aliases(
            database, [text for row in events.rows for text in (row.actor, row.subject)]
        ),
        next=events.cursor,
        action=action,
        first=first,
        last=last,
        of_study=study,
    )


def _midnight(day: date) -> datetime:
    return datetime.combine(day, time(), UTC)
