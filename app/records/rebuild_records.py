"""Effective records built again from runs and events, to check what is stored or to put it right."""

from dataclasses import dataclass

from app.db.session import Database
from app.meals.stored.meal_parts import meals_after, parts_of
from app.records.project_records import Projector, count_stale, write_records

BATCH = 50  # meals a transaction: writers wait for no more than that


@dataclass(frozen=True, slots=True)
class Rebuilt:
    """How many records were compared; of how many items or leftovers what is stored differs from a fresh projection."""

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
                different += (
                    write_records(session, projection)
                    if write
                    else count_stale(session, projection)
                )
