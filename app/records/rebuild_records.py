"""Effective records built again from runs and events: a projection can always be checked against what it comes from."""

from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.candidates.project_index import differing_entries
from app.db.session import Database
from app.meals.meal_parts import meals_after, parts_of, records_of
from app.records.project_records import MealProjection, Projector, differences, entries_wanted, write_records

BATCH = 50  # meals a transaction: writers wait for no more than that


@dataclass(frozen=True, slots=True)
class Rebuilt:
    """How many records were compared; of how many items record or entry in the index is not what would be built."""

    compared: int
    different: int


def rebuild_records(database: Database, *, write: bool) -> Rebuilt:
    """Compare every effective record with what its item comes to; with `write`, put right those that differ."""
    compared = different = 0
    after = None
    while True:
        opened = database.write() if write else database.read()
        with opened as session:
            batch = meals_after(session, after, BATCH, lock=write)
            if not batch:
                return Rebuilt(compared, different)
            after = batch[-1].id
            projector = Projector(session)
            for parts in parts_of(session, batch):
                projection = projector.project(parts)
                compared += len(projection.items)
                different += write_records(session, projection) if write else _count(session, projection)


def _count(session: Session, projection: MealProjection) -> int:
    """Of how many items of a meal the record or the index's entry differs."""
    meal_id = projection.parts.meal.id
    different = set(differing_entries(session, meal_id, entries_wanted(projection)))
    here = records_of(session, meal_id)
    for item in projection.items:
        item_id = item.state.item.id
        record = here.get(item_id)
        if record is None or differences(record, item.columns):
            different.add(item_id)
    return len(different)
