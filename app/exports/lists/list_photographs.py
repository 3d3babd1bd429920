"""The image manifest in pages: the photographs of `limit` meals at a time, in the order of capture."""

from app.db.session import Database
from app.exports.lists.meal_page_queries import keys_of, search_of
from app.exports.tables.export_meals import PHOTOGRAPH_READERS, photographs_of
from app.exports.tables.export_table import named_cells
from app.http.paging import ID, INSTANT, Page, decode_cursor, encode_cursor, list_name
from app.http.row_filter import RowFilter
from app.http.tables.columns import Cell
from app.http.tables.photograph_columns import PHOTOGRAPH_PARTS
from app.people.access.caller import Caller, visible_rows


def list_photographs(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[dict[str, Cell]]:
    """Return the photographs of at most `limit` meals, each as column -> value of the manifest.

    Raises InvalidInputError for a cursor that is broken or of other filters.
    """
    chosen = visible_rows(caller, chosen)
    listed = list_name("photographs", chosen)
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        search = search_of(session, chosen)
        if search is None:
            return Page([], None)
        keys = keys_of(session, search, after, limit + 1, is_newest_first=False)
        rows = photographs_of(session, [meal_id for _, meal_id in keys[:limit]])
    photographs = [named_cells(PHOTOGRAPH_PARTS, PHOTOGRAPH_READERS, row) for row in rows]
    return Page(photographs, encode_cursor(listed, *keys[limit - 1]) if len(keys) > limit else None)
