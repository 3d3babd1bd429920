"""The image manifest in pages of photographs, in the order of capture."""

from dataclasses import replace

from app.db.session import Database
from app.exports.lists.meal_page_queries import keys_of, search_of
from app.exports.tables.export_meals import PHOTOGRAPH_READERS, Photograph, photographs_of
from app.exports.tables.export_table import named_cells
from app.http.paging import ID, INSTANT, Page, Part, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.http.tables.columns import Cell
from app.http.tables.photograph_columns import PHOTOGRAPH_PARTS
from app.people.access.caller import Caller, visible_rows
from app.photos.slots import SLOTS
from app.records.page_queries import Key

SLOT: Part[str] = Part(lambda text: SLOTS[SLOTS.index(text)])


def list_photographs(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[dict[str, Cell]]:
    """Return a page, each photograph as column -> value of the manifest.

    Raises InvalidInputError for a cursor that is broken or of other filters.
    """
    chosen = replace(visible_rows(caller, chosen), origin="photographed")
    listed = list_name("photographs", chosen)
    behind = decode_cursor(listed, cursor, INSTANT, ID, SLOT)
    photographs: list[Photograph] = []
    after: Key | None = None
    with database.read() as session:
        if behind is not None:  # the rest of the meal at which the page before ended
            captured_at, meal_id, slot = behind
            after = (captured_at, meal_id)
            later_slots = SLOTS[SLOTS.index(slot) + 1 :]
            of_meal = photographs_of(session, [meal_id])
            photographs = [(meal, image) for meal, image in of_meal if image.slot in later_slots]
        search = search_of(session, chosen)
        while search is not None and (missing := limit + 1 - len(photographs)) > 0:
            keys = keys_of(session, search, after, missing, is_newest_first=False)
            photographs += photographs_of(session, [meal_id for _, meal_id in keys])
            if len(keys) < missing:
                break
            after = keys[-1]
    page = page_of(listed, photographs, limit, lambda one: (one[0].captured_at, one[0].id, one[1].slot))
    return Page([named_cells(PHOTOGRAPH_PARTS, PHOTOGRAPH_READERS, one) for one in page.rows], page.cursor)
