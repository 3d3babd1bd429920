"""A study's changes since a client's last request: changed records and days, and erasures.

Change numbers are assigned under a lock, so a change that commits late has a late number and a client misses nothing.
An erased record is identified by the SHA-256 of its id: a client that has a copy can find it, the server no longer can.
"""

import uuid
from dataclasses import dataclass

from app.core.errors import NotFoundError
from app.db.session import Database
from app.exports.lists import change_queries as changes
from app.exports.lists.change_queries import KINDS, Change, Place
from app.http.paging import TEXT, WHOLE_NUMBER, broken_cursor, decode_cursor, encode_cursor
from app.people import queries as people

START = Place(0, KINDS[-1], "")


@dataclass(frozen=True, slots=True)
class ChangePage:
    """Rows in the order of changes. cursor: continues after them, now or later. has_more: there are more now."""

    rows: list[Change]
    cursor: str
    has_more: bool


def list_changes(
    database: Database, study_code: str, *, cursor: str | None, limit: int
) -> ChangePage:
    """Return the changes after the cursor, or all. Raises NotFoundError, InvalidInputError for a broken cursor."""
    listed = f"changes of {study_code}"
    after = _place(decode_cursor(listed, cursor, WHOLE_NUMBER, TEXT, TEXT))
    with database.read() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError("There is no such study.")
        rows = changes.page_of_changes(session, study.id, after, limit + 1)
    page = rows[:limit]
    last = page[-1].place if page else after
    return ChangePage(
        page, encode_cursor(listed, last.change_seq, last.kind, last.key), len(rows) > limit
    )


def _place(key: tuple[int, str, str] | None) -> Place:
    """Return the place of a cursor's key. Raises InvalidInputError."""
    if key is None:
        return START
    number, kind, row = key
    if kind not in KINDS:
        raise broken_cursor()
    if kind != "erased":
        try:
            uuid.UUID(row)
        except ValueError:
            raise broken_cursor() from None
    return Place(number, kind, row)
