"""The image manifest in pages: photographs of so many meals at a time, in the order of capture."""

import json
from dataclasses import asdict
from typing import Any

from app.db.session import Database
from app.exports.lists.list_meals import visible_meals
from app.exports.lists.meal_page_queries import MealFilter, keys_of, search_of
from app.exports.tables.export_meals import photographs_of
from app.http.cursors import ID, INSTANT, Page, decode_cursor, encode_cursor
from app.http.tables.columns import columns_of
from app.http.tables.photograph_columns import PHOTOGRAPH_PARTS
from app.people.access.caller import Caller


def list_photographs(
    database: Database, caller: Caller, chosen: MealFilter, *, cursor: str | None, limit: int
) -> Page[dict[str, Any]]:
    """The photographs of at most `limit` meals, each as the manifest's columns by name.

    Raises InvalidInputError for a cursor that is broken or of others.
    """
    listed = "photographs " + json.dumps(asdict(chosen), default=str, sort_keys=True)
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        search = search_of(session, visible_meals(caller, chosen))
        if search is None:
            return Page([], None)
        keys = keys_of(session, search, after, limit + 1, is_newest_first=False)
        rows = photographs_of(session, [meal_id for _, meal_id in keys[:limit]])
    names = [column.name for column in columns_of(PHOTOGRAPH_PARTS)]
    found = [dict(zip(names, _flat(row), strict=True)) for row in rows]
    return Page(found, encode_cursor(listed, *keys[limit - 1]) if len(keys) > limit else None)


def _flat(row: tuple[Any, ...]) -> list[Any]:
    return [value for part in row for value in (part if isinstance(part, tuple) else (part,))]
