"""Effective records built again from runs and items: a projection can always be checked against what it comes from."""

from collections.abc import Iterator
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.db.models import EffectiveRecord
from app.db.queries import records
from app.db.session import Database
from app.services.save_estimate import keep_status, record_values

BATCH = 200  # items a transaction: writers wait for no more than that


@dataclass(frozen=True, slots=True)
class Rebuilt:
    """How many records were compared, and how many were missing or other than what would be built."""

    compared: int
    different: int


def rebuild_records(database: Database, *, write: bool) -> Rebuilt:
    """Compare every effective record with what its item comes to; with `write`, put right those that differ."""
    compared = different = 0
    after = None
    while True:
        opened = database.write() if write else database.read()
        with opened as session:
            batch = records.items_after(session, after, BATCH)
            if not batch:
                return Rebuilt(compared, different)
            after = batch[-1].item.id
            compared += len(batch)
            different += sum(1 for _ in _mend(session, batch, write=write))


def _mend(session: Session, batch: list[records.ItemSource], *, write: bool) -> Iterator[EffectiveRecord]:
    """The records that differ, put right if `write`."""
    for source in batch:
        wanted = record_values(session, source.meal, source.item, source.taken_for)
        record = session.get(EffectiveRecord, source.item.id)
        if record is None:
            record = EffectiveRecord(item_id=source.item.id, change_seq=0)
        else:
            wanted = keep_status(record, wanted)
            if all(getattr(record, name) == value for name, value in wanted.items()):
                continue
        if write:
            for name, value in wanted.items():
                setattr(record, name, value)
            record.change_seq = records.next_change_seq(session, source.meal.study_id)
            session.add(record)
        yield record
