"""Effective records made again: projected anew, or computed by the food tables and densities that are in force now.

To rebuild is to compare what is stored with a fresh projection of runs and events, and to put it
right. To recompute is to leave volumes, foods and statuses as they are: an item whose food has
other figures, another density or another edible share by now gets a new row of the food that it is
taken for, and its effective record follows; the old rows stay. What a person chose stays chosen:
the food goes by its key. An item whose food is in no table any more is left as it is and counted.
Doing it again changes nothing.
"""

import uuid
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.food_amounts import Weighing
from app.foods.models import Food
from app.meals.stored.meal_parts import MealParts, meals_after, parts_of
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, ItemFood, Recompute
from app.nutrition.components import HEADLINE_COLUMNS
from app.people import queries as people
from app.records.item_foods import item_food, weighing_for, weighing_of
from app.records.project_records import (
    MealProjection,
    Projector,
    count_stale,
    with_food,
    write_records,
)

BATCH = 50  # meals a transaction: writers wait for no more than that
COMPARED = ("density_g_per_ml", "mass_g", "edible_g", "left_g", "consumed_g", *HEADLINE_COLUMNS)


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
    database: Database,
    *,
    write: bool,
    author: str,
    reason: str,
    study_code: str | None = None,
    tell: Listener,
) -> Recomputed:
    """Compare every record with what its food comes to now; with `write`, make new ones of those that differ.

    tell: called with each difference. Raises NotFoundError for an unknown study; ConflictError if
    somebody else changes the same items at this moment: what was written before stays, and doing it
    again does the rest.
    """
    work = _Recomputation(author, reason, write=write)
    study_id = _study_id(database, study_code)
    after = None
    while True:
        try:
            with database.write() if write else database.read() as session:
                batch = meals_after(session, after, BATCH, lock=write, study_id=study_id)
                if not batch:
                    return work.done
                differences = work.batch(session, batch)
        except IntegrityError:
            raise ConflictError(
                "Somebody else changes the same items at this moment: do it again for the rest.",
                code="recompute_running",
            ) from None
        after = batch[-1].id
        for difference in differences:
            tell(difference)


class _Recomputation:
    """One run through the meals: what it has done, and what it knows of foods (they do not change under way)."""

    def __init__(self, author: str, reason: str, *, write: bool) -> None:
        self.done = Recomputed()
        self._write = write
        self._row = Recompute(
            id=uuid.uuid4(),
            author=author,
            reason=reason,
            food_releases=[],
            started_at=datetime.now(UTC),
        )
        self._is_noted = False
        self._weighings: dict[tuple[int, uuid.UUID, str | None], Weighing] = {}

    def batch(self, session: Session, batch: Sequence[Meal]) -> list[RecordDifference]:
        """The differences of the items of these meals, written if so wanted."""
        projector = Projector(session)
        before = [projector.project(parts) for parts in parts_of(session, batch)]
        keys = {
            projector.food(row.food_id).key for meal in before for row in _food_assignments(meal)
        }
        in_force = foods.foods_by_key(session, keys)
        return [
            difference
            for meal in before
            for difference in self._meal(session, projector, meal, in_force)
        ]

    def _meal(
        self,
        session: Session,
        projector: Projector,
        before: MealProjection,
        in_force: Mapping[str, Food],
    ) -> list[RecordDifference]:
        rows = []
        for row in _food_assignments(before):
            self.done.compared += 1
            key = projector.food(row.food_id).key
            if key in in_force:
                rows += self._newer_row(session, projector, before.parts, row, in_force[key])
            else:
                self.done.gone[key] += 1
        if not rows:
            return []
        parts = before.parts
        for row in rows:
            parts = with_food(parts, row, projector.food(row.food_id).key)
        after = projector.project(parts)
        differences = [_difference(session, projector, after, row) for row in rows]
        if self._write:
            self._note(session)
            session.add_all(rows)
            session.flush()
            write_records(session, after)
        self.done.changed += len(differences)
        return differences

    def _newer_row(
        self, session: Session, projector: Projector, parts: MealParts, row: ItemFood, food: Food
    ) -> list[ItemFood]:
        """The row that takes this one's place, by the same word as it, if figures or weighing are others by now."""
        weighing = self._weighing(session, food, parts.meal.study_id, row.lies_as)
        if projector.contents(food.id) == projector.contents(
            row.food_id
        ) and weighing == weighing_of(row):
            return []
        version = 1 + max(each.version for each in parts.foods[row.item_id])
        newer = item_food(
            row.item_id,
            food.id,
            weighing,
            row.lies_as,
            version=version,
            layer=row.layer,
            event_id=row.event_id,
            recompute_id=self._row.id,
        )
        return [newer]

    def _note(self, session: Session) -> None:
        """Who did this, once, with the first change."""
        if not self._is_noted:
            releases = foods.releases_in_force(session)
            self._row.food_releases = [f"{release.name} {release.version}" for release in releases]
            session.add(self._row)
            session.flush()
            self._is_noted = True

    def _weighing(
        self, session: Session, food: Food, study_id: uuid.UUID, lies_as: str | None
    ) -> Weighing:
        key = (food.id, study_id, lies_as)
        if key not in self._weighings:
            self._weighings[key] = weighing_for(session, food, study_id, lies_as)
        return self._weighings[key]


def _food_assignments(meal: MealProjection) -> list[ItemFood]:
    """Return the items' food assignments.

    Items that are no longer foods of the meal are left unchanged.
    """
    return [
        item.state.food_assignment
        for item in meal.items
        if item.state.food_assignment is not None and item.state.is_live
    ]


def _difference(
    session: Session, projector: Projector, after: MealProjection, row: ItemFood
) -> RecordDifference:
    record = session.get_one(EffectiveRecord, row.item_id)
    computed = next(item.columns for item in after.items if item.state.item.id == row.item_id)
    columns = {
        name: (getattr(record, name), computed[name])
        for name in COMPARED
        if getattr(record, name) != computed[name]
    }
    return RecordDifference(
        row.item_id, after.parts.meal.client_id, projector.food(row.food_id).key, columns
    )


def _study_id(database: Database, study_code: str | None) -> uuid.UUID | None:
    if study_code is None:
        return None
    with database.read() as session:
        study = people.find_study(session, study_code)
    if study is None:
        raise NotFoundError(f"There is no study {study_code!r}.")
    return study.id


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
