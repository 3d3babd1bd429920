"""Decide items without seeing the other reviewer; settle an item once two agree, or a third has decided.

A decision changes neither the meal nor its records. The result does, by the events that a reviewer
would send: food and grams, or a rejection, in the name of who settled it.
"""

import statistics
import uuid
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import unless_taken
from app.foods.food_amounts import food_amounts
from app.foods.models import Food
from app.http.state import ApiState
from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.meals.stored.meal_parts import parts_of
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.mass import weighed_mass
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Study
from app.records.double_review import queries as double
from app.records.double_review.drawn import DIGITS, PLACES, decisions, protocol_of
from app.records.double_review.schemas import DecisionIn
from app.records.item_foods import weighing_for
from app.records.project_records import Projector, project_meal
from app.records.read_meal import lock_with_person
from app.records.review.meal_events import MealEvents
from app.records.review.queries import QueueRow
from app.records.review.review_context import STATED_SD, named_food
from app.records.review.review_items import review_items
from app.records.review.schemas import AnyEventIn, RejectIn, SetFoodIn, SetMassIn
from app.records.serve_photo import find_photo, render_photo

OTHERS = 4  # foods beside that of a known item
COUNT = decisions().with_only_columns(sa.func.count()).scalar_subquery()


@dataclass(frozen=True, slots=True)
class BlindItem:
    """An item as a reviewer sees it, of a meal or with a known answer: nothing tells which.

    size_px: width and height of the picture; None: it was erased
    decisions: (decision, reviewer) of the two that differ, which only a third reviewer gets
    """

    id: uuid.UUID
    choices: Sequence[Food]
    mass_g: float | None
    rings: Sequence[Sequence[Sequence[float]]]
    size_px: tuple[int, int] | None
    decisions: Sequence[tuple[ReviewDecision, str]]


@dataclass(frozen=True, slots=True)
class BlindReview:
    """A reviewer's work on the items of a study that two decide."""

    state: ApiState
    caller: StaffCaller
    study: Study

    def next_item(
        self, day: date | None, skipped: Collection[uuid.UUID], *, differing: bool = False
    ) -> BlindItem | None:
        """Return the caller's next item, by the meals' time, now and then one with a known answer.

        What others have decided changes nothing, until two have decided an item.

        differing: of those that two others have decided differently, which a third settles
        """
        protocol, record = protocol_of(self.study), EffectiveRecord
        if protocol is None:
            return None
        with self.state.database.read() as session:
            decided = double.decided_items(session, self.study.id, self.caller.staff_id)
            is_known = self.draw(len(decided)) < protocol.known_share
            if is_known and not differing:
                known = double.known_item(session, self.study.id, decided.union(skipped))
                if known is not None:
                    return _known_item(session, known)
            is_own = decisions(ReviewDecision.staff_id == self.caller.staff_id).exists()
            is_asked = COUNT == 2 if differing else COUNT < 2
            conditions = [is_asked, ~is_own, record.item_id.not_in(skipped)]
            if day is not None:
                conditions.append(record.local_date == day)
            row = double.blind_row(session, self.study, *conditions)
            return _item(session, row) if row is not None else None

    def draw(self, number: int) -> float:
        """Return a number in [0, 1) for each of the caller's decisions, which only the server can tell."""
        name = f"{self.study.id}/{self.caller.staff_id}/{number}"
        return int(self.state.part(SecretBox).digest("known_item", name)[:DIGITS], 16) / PLACES

    def picture(self, item_id: uuid.UUID, width_px: int) -> bytes:
        """Return the item's picture as JPEG. Raises NotFoundError, and what render_photo does."""
        with self.state.database.read() as session:
            known = session.get(KnownItem, item_id)
            row = double.blind_row(session, self.study, EffectiveRecord.item_id == item_id)
        if known is not None and known.study_id == self.study.id:
            return known.picture
        if row is None:
            raise _no_item()
        meal_id, code = row.meal.client_id, row.participant_code
        photo = find_photo(self.state.database, self.caller, meal_id, "left", code)
        return render_photo(self.state, self.caller, photo, width_px)

    def decide(self, body: DecisionIn, *, differing: bool = False) -> ReviewDecision:
        """Keep the decision, and settle the item if that follows.

        differing: the caller saw the two decisions that differ

        Raises NotFoundError, ConflictError (`item_decided`), InvalidInputError.
        """
        taken = ConflictError("You have decided this item.", code="item_decided")
        with unless_taken(taken), self.state.database.write() as session:
            meal = self._lock_meal(session, body.item)
            earlier = [decision for decision, _ in double.decisions_of(session, body.item)]
            if meal is not None and differing != (len(earlier) == 2):
                raise _no_item()  # decided or undone by others since it was shown
            decision = ReviewDecision(
                id=uuid.uuid4(),
                study_id=self.study.id,
                meal_id=meal.id if meal is not None else None,
                item_id=body.item,
                staff_id=self.caller.staff_id,
                is_final=differing,
                food_key=body.food,
                mass_g=body.mass_g,
                energy_kcal=self._energy_kcal(session, body),
                decided_at=datetime.now(UTC),
            )
            session.add(decision)
            session.flush()
            self._note(session, "item.decide", meal)
            if meal is not None and earlier:
                self._settle(session, meal, [*earlier, decision])
            return decision

    def undo(self, decision_id: uuid.UUID) -> None:
        """Take a decision of the caller's back, until the item is settled. Raises NotFoundError."""
        with self.state.database.write() as session:
            decision = session.get(ReviewDecision, decision_id)
            if decision is None or decision.staff_id != self.caller.staff_id:
                raise _no_item()
            meal = self._lock_meal(session, decision.item_id)
            decision.undone_at = datetime.now(UTC)
            self._note(session, "item.undecide", meal)

    def _lock_meal(self, session: Session, item_id: uuid.UUID) -> Meal | None:
        """Lock the meal of an item that is not settled; None: it is a known item. Raises NotFoundError."""
        known, record = session.get(KnownItem, item_id), session.get(EffectiveRecord, item_id)
        if known is not None and known.study_id == self.study.id:
            return None
        if record is not None:
            meal = lock_with_person(session, session.get_one(Meal, record.meal_id))
            is_item = EffectiveRecord.item_id == item_id
            if double.blind_row(session, self.study, is_item) is not None:
                return meal
        raise _no_item()

    def _energy_kcal(self, session: Session, body: DecisionIn) -> float | None:
        if body.food is None or body.mass_g is None:
            return None
        food = named_food(session, body.food)
        weighing = weighing_for(session, food, self.study.id, None)
        mass = weighed_mass(
            body.mass_g, STATED_SD, is_edible=False, edible_share=weighing.edible_share
        )
        contents = Projector(session).contents(food.id)
        return food_amounts(food.key, contents, weighing, mass).headline("energy_kcal")

    def _settle(self, session: Session, meal: Meal, made: Sequence[ReviewDecision]) -> None:
        """Write the result of two decisions that agree, or of the third, as events of the meal."""
        first, second, *_, last = *made, made[-1]
        mass_g, protocol = last.mass_g, protocol_of(self.study)
        if not last.is_final:
            if first.food_key != second.food_key:
                return
            if first.mass_g is not None and second.mass_g is not None and protocol is not None:
                mass_g = statistics.fmean((first.mass_g, second.mass_g))
                if abs(first.mass_g - second.mass_g) > protocol.limit_percent / 100 * mass_g:
                    return
        for decision in made:
            decision.settled_at = datetime.now(UTC)
        session.flush()
        item, events = last.item_id, list[AnyEventIn]()
        if last.food_key is None:
            events.append(RejectIn(id=uuid.uuid4(), kind="reject", item=item))
        else:
            events.append(
                SetFoodIn(id=uuid.uuid4(), kind="set_food", item=item, food=last.food_key)
            )
            events.append(SetMassIn(id=uuid.uuid4(), kind="set_mass", item=item, mass_g=mass_g))
        for event in events:
            parts = parts_of(session, [meal])[0]
            self.state.part(MealEvents).write(session, self.caller, parts, event)
        project_meal(session, meal)

    def _note(self, session: Session, action: str, meal: Meal | None) -> None:
        subject = meal.alias if meal is not None else None
        audit.note(session, self.caller, action, study_id=self.study.id, subject=subject)


def _item(session: Session, row: QueueRow) -> BlindItem:
    (item,) = review_items(session, [row])
    photograph, item_id = item.photograph, row.record.item_id
    foods = [candidate.food for candidate in item.candidates.candidates]
    made = double.decisions_of(session, item_id)
    return BlindItem(
        id=item_id,
        choices=_by_name([row.food, *foods]),
        mass_g=row.record.mass_g,
        rings=item.rings,
        size_px=(photograph.width_px, photograph.height_px) if photograph is not None else None,
        decisions=made if len(made) == 2 else (),
    )


def _known_item(session: Session, known: KnownItem) -> BlindItem:
    """Show a known item as one of a meal: its food is among others of its group."""
    food = named_food(session, known.food_key)
    others = double.like_foods(session, food, OTHERS)
    size_px = known.width_px, known.height_px
    return BlindItem(known.id, _by_name([food, *others]), known.shown_g, known.rings, size_px, ())


def _by_name(foods: Iterable[Food | None]) -> list[Food]:
    """Return each food once, by name: their order tells nothing."""
    by_key = {food.key: food for food in foods if food is not None}
    return sorted(by_key.values(), key=lambda food: food.name)


def _no_item() -> NotFoundError:
    return NotFoundError("No such item waits to be decided by two.", code="item_not_found")
