"""The image manifest in pages of photographs, in the order of capture."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.session import Database
from app.exports.lists.meal_page_queries import keys_of, search_of
from app.http.paging import ID, INSTANT, Page, Part, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.meals.stored.models import Meal, MealImage
from app.people.access.caller import Caller, visible_rows
from app.people.models import Participant, Study
from app.photos.slots import SLOTS
from app.records.page_queries import Key

SLOT: Part[str] = Part(lambda text: SLOTS[SLOTS.index(text)])


@dataclass(frozen=True, slots=True)
class ListedPhotograph:
    """A photograph with its meal and the names that go with it."""

    image: MealImage
    meal: Meal
    study: str
    participant: str

    @property
    def path(self) -> str | None:
        """Where its picture is served; None: it was erased."""
        if self.image.erased_at is not None:
            return None
        path = f"/v1/meals/{self.meal.client_id}/images/{self.image.slot}"
        return f"{path}?participant={quote(self.participant, safe='')}"


def list_photographs(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[ListedPhotograph]:
    """Return a page. Raises InvalidInputError for a cursor that is broken or of other filters."""
    chosen = replace(visible_rows(caller, chosen), origin="photographed")
    listed = list_name("photographs", chosen)
    behind = decode_cursor(listed, cursor, INSTANT, ID, SLOT)
    photographs: list[ListedPhotograph] = []
    after: Key | None = None
    with database.read() as session:
        if behind is not None:  # the rest of the meal at which the page before ended
            captured_at, meal_id, slot = behind
            after = (captured_at, meal_id)
            later_slots = SLOTS[SLOTS.index(slot) + 1 :]
            of_meal = _photographs_of(session, [meal_id])
            photographs = [shown for shown in of_meal if shown.image.slot in later_slots]
        search = search_of(session, chosen)
        while search is not None and (missing := limit + 1 - len(photographs)) > 0:
            keys = keys_of(session, search, after, missing, is_newest_first=False)
            photographs += _photographs_of(session, [meal_id for _, meal_id in keys])
            if len(keys) < missing:
                break
            after = keys[-1]
    return page_of(listed, photographs, limit, _key)


def _key(photograph: ListedPhotograph) -> tuple[object, ...]:
    return photograph.meal.captured_at, photograph.meal.id, photograph.image.slot


def _photographs_of(session: Session, ids: Sequence[uuid.UUID]) -> list[ListedPhotograph]:
    """The photographs of these meals in the order of capture, and of the slots."""
    query = (
        sa.select(MealImage, Meal, Study.code, Participant.code)
        .join(Meal, Meal.id == MealImage.meal_id)
        .join(Study, Study.id == Meal.study_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.id.in_(ids))
    )
    photographs = [ListedPhotograph(*row) for row in session.execute(query)]
    return sorted(
        photographs,
        key=lambda photograph: (
            photograph.meal.captured_at,
            photograph.meal.id,
            SLOTS.index(photograph.image.slot),
        ),
    )
