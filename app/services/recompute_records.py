"""Records computed anew by the food tables and densities that are in force now: volumes, foods and statuses stay.

An item whose food has other figures, another density or another edible share by now gets a new row of what it is taken
for, and its effective record follows; the old rows stay. What a person chose stays chosen: the food goes by its key. An
item whose food is in no table any more is left as it is and counted. Doing it again changes nothing.
"""

import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.models import EffectiveRecord, Food, ItemFood, Recompute
from app.db.queries import foods, people, records
from app.db.queries.records import ItemSource
from app.db.session import Database
from app.errors import ConflictError, NotFoundError
from app.services.food_amounts import RECORD_COLUMNS, Weighing
from app.services.item_foods import item_food, weighing_for, weighing_of
from app.services.save_estimate import keep_status, record_values

BATCH = 200  # items a transaction: writers wait for no more than that
COMPARED = ("density_g_per_ml", "mass_g", "edible_g", *RECORD_COLUMNS)


@dataclass(frozen=True, slots=True)
class RecordDifference:
    """One record that changes. columns: name -> (before, after), of those of COMPARED that differ.

    Without any, only components beyond the headline ones differ, or the source of the density.
    """

    item_id: uuid.UUID
    meal_id: uuid.UUID
    food_key: str
    columns: dict[str, tuple[float | None, float | None]]


@dataclass(slots=True)
class Recomputed:
    """How many records were compared and changed; gone: key -> records whose food is in no table in force."""

    compared: int = 0
    changed: int = 0
    gone: Counter[str] = field(default_factory=Counter)


Listener = Callable[[RecordDifference], None]


def recompute_nutrients(
    database: Database, *, write: bool, author: str, reason: str, study_code: str | None = None, tell: Listener
) -> Recomputed:
    """Compare every record with what its food comes to now; with `write`, make new ones of those that differ.

    tell: called with each difference. Raises NotFoundError for an unknown study; ConflictError if somebody else changes
    the same items at this moment: what was written before stays, and doing it again does the rest.
    """
    work = _Recomputation(author, reason, write=write)
    study_id = _study_id(database, study_code)
    after = None
    while True:
        try:
            with database.write() if write else database.read() as session:
                batch = records.items_after(session, after, BATCH, study_id=study_id)
                if not batch:
                    return work.done
                differences = work.batch(session, batch)
        except IntegrityError:
            raise ConflictError(
                "Somebody else changes the same items at this moment: do it again for the rest.",
                code="recompute_running",
            ) from None
        after = batch[-1].item.id
        for difference in differences:
            tell(difference)


class _Recomputation:
    """One run through the items: what it has done, and what it knows of foods (they do not change under way)."""

    def __init__(self, author: str, reason: str, *, write: bool) -> None:
        self.done = Recomputed()
        self._write = write
        self._row = Recompute(
            id=uuid.uuid4(), author=author, reason=reason, food_releases=[], started_at=datetime.now(UTC)
        )
        self._is_noted = False
        self._weighings: dict[tuple[int, uuid.UUID, str | None], Weighing] = {}
        self._contents: dict[int, dict[str, float]] = {}

    def batch(self, session: Session, batch: list[ItemSource]) -> list[RecordDifference]:
        """The differences of these items, written if so wanted."""
        taken = [source for source in batch if source.taken_for is not None]
        old_foods = {food.id: food for food in foods.foods_by_id(session, {_taken(source).food_id for source in taken})}
        in_force = foods.foods_by_key(session, {food.key for food in old_foods.values()})
        self.done.compared += len(taken)
        differences = []
        for source in taken:
            key = old_foods[_taken(source).food_id].key
            food = in_force.get(key)
            if food is None:
                self.done.gone[key] += 1
                continue
            difference = self._compare(session, source, food)
            if difference is not None:
                differences.append(difference)
        self.done.changed += len(differences)
        return differences

    def _compare(self, session: Session, source: ItemSource, food: Food) -> RecordDifference | None:
        taken_for, study_id = _taken(source), source.meal.study_id
        weighing = self._weighing(session, food, study_id, taken_for.lies_as)
        same_figures = self._content(session, food.id) == self._content(session, taken_for.food_id)
        if same_figures and weighing == weighing_of(taken_for):
            return None
        row = item_food(
            source.item.id,
            food.id,
            weighing,
            taken_for.lies_as,
            version=taken_for.version + 1,
            recompute_id=self._row.id,
        )
        wanted = record_values(session, source.meal, source.item, row)
        record = session.get_one(EffectiveRecord, source.item.id)
        columns = {
            name: (getattr(record, name), wanted[name]) for name in COMPARED if getattr(record, name) != wanted[name]
        }
        if self._write:
            self._note(session)
            session.add(row)
            for name, value in keep_status(record, wanted).items():
                setattr(record, name, value)
            record.change_seq = records.next_change_seq(session, study_id)
        return RecordDifference(source.item.id, source.meal.client_id, food.key, columns)

    def _note(self, session: Session) -> None:
        """Who did this, once, with the first change."""
        if not self._is_noted:
            releases = foods.releases_in_force(session)
            self._row.food_releases = [f"{release.name} {release.version}" for release in releases]
            session.add(self._row)
            session.flush()
            self._is_noted = True

    def _weighing(self, session: Session, food: Food, study_id: uuid.UUID, lies_as: str | None) -> Weighing:
        key = (food.id, study_id, lies_as)
        if key not in self._weighings:
            self._weighings[key] = weighing_for(session, food, study_id, lies_as)
        return self._weighings[key]

    def _content(self, session: Session, food_id: int) -> dict[str, float]:
        if food_id not in self._contents:
            known = foods.nutrients_of(session, food_id)
            self._contents[food_id] = {row.component.number: row.per_100_g for row in known}
        return self._contents[food_id]


def _taken(source: ItemSource) -> ItemFood:
    if source.taken_for is None:
        raise ValueError(f"item {source.item.id} is taken for no food")
    return source.taken_for


def _study_id(database: Database, study_code: str | None) -> uuid.UUID | None:
    if study_code is None:
        return None
    with database.read() as session:
        study = people.find_study(session, study_code)
    if study is None:
        raise NotFoundError(f"There is no study {study_code!r}.")
    return study.id
