"""Which pairs of photographs a remeasurement takes, and why it skips one. Nothing here changes a meal."""

import hashlib
import json
import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.children.faults import CANCELLED, PHOTOGRAPH_ERASED
from app.core.errors import NotFoundError
from app.meals.stored.job_models import PairPurpose
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.queries import WAITING
from app.people.models import Participant
from app.photos.slots import AFTER_SLOTS

MOST_MEALS = 1000  # named one by one

NO_PHOTOGRAPHS = "no_photographs"  # reasons to skip a pair, beside the codes of faults.py
INCOMPLETE = "incomplete"
WAITS = "waits_for_estimate"
WITHDRAWN = "withdrawn"
NOTHING_LEFT = "nothing_left"


@dataclass(frozen=True, slots=True)
class Selection:
    """The meals of a study to measure again. meals: ids made by phones; none: all. limit: only the first meals."""

    meals: frozenset[uuid.UUID] = frozenset()
    limit: int | None = None

    @property
    def digest(self) -> str:
        """SHA-256 by which the same selection is recognised; the ids themselves could outlive an erased meal."""
        named = json.dumps([self.limit, sorted(str(meal) for meal in self.meals)])
        return hashlib.sha256(named.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class PlannedPair:
    """A pair, and why it would be skipped; None: it would be measured."""

    participant: str
    meal: uuid.UUID
    pair: PairPurpose
    skip: str | None


def chosen_meals(session: Session, study_id: uuid.UUID, selection: Selection) -> sa.Subquery:
    """Return a query of (id, position): the meals in the order in which they were eaten.

    Raises NotFoundError if the study lacks a meal that is named.
    """
    eaten = (Meal.captured_at, Meal.id)
    query = sa.select(Meal.id, (sa.func.row_number().over(order_by=eaten) - 1).label("position"))
    query = query.where(Meal.study_id == study_id).order_by(*eaten).limit(selection.limit)
    if selection.meals:
        named = Meal.client_id.in_(selection.meals)
        present = set(
            session.scalars(sa.select(Meal.client_id).where(Meal.study_id == study_id, named))
        )
        for missing in sorted(selection.meals - present):
            raise NotFoundError(f"The study has no meal {missing}.", meal=str(missing))
        query = query.where(named)
    return query.subquery("chosen")


def has_after_pair() -> sa.ColumnElement[bool]:
    """Return whether photographs of a meal's after-meal pair have arrived."""
    return sa.exists().where(MealImage.meal_id == Meal.id, MealImage.slot.in_(AFTER_SLOTS))


def plan(session: Session, study_id: uuid.UUID, selection: Selection) -> list[PlannedPair]:
    """Return the pairs that a remeasurement would take, in its order. Raises NotFoundError as chosen_meals."""
    chosen = chosen_meals(session, study_id, selection)
    query = (
        sa.select(Meal, Participant, has_after_pair())
        .join(chosen, chosen.c.id == Meal.id)
        .join(Participant, Participant.id == Meal.participant_id)
        .order_by(chosen.c.position)
    )
    rows = session.execute(query).all()
    images = _images_of(session, chosen)
    pairs: list[PlannedPair] = []
    for meal, participant, has_after in rows:
        purposes: tuple[PairPurpose, ...] = ("meal", "after") if has_after else ("meal",)
        pairs += [
            PlannedPair(
                participant.code,
                meal.client_id,
                pair,
                skip_reason(
                    meal,
                    pair,
                    images.get(meal.id, ()),
                    is_withdrawn=participant.withdrawn_at is not None,
                ),
            )
            for pair in purposes
        ]
    return pairs


def skip_reason(
    meal: Meal, pair: PairPurpose, images: Collection[MealImage], *, is_withdrawn: bool
) -> str | None:
    """Return why a pair is not measured again; None: it is. images: all of the meal's."""
    status, failure_code = (
        (meal.status, meal.failure_code)
        if pair == "meal"
        else (meal.after_status, meal.after_failure_code)
    )
    slots = meal.announced_slots if pair == "meal" else AFTER_SLOTS
    stored = {image.slot: image for image in images if image.slot in slots}
    if is_withdrawn:
        return WITHDRAWN
    if meal.origin == "declared":
        return NO_PHOTOGRAPHS
    if any(image.erased_at is not None for image in stored.values()):
        return PHOTOGRAPH_ERASED.code
    if status in WAITING:
        return WAITS
    if status == "receiving" or not stored.keys() >= set(slots):
        return INCOMPLETE
    if status == "failed" and failure_code == CANCELLED.code:
        return CANCELLED.code
    return NOTHING_LEFT if status == NOTHING_LEFT else None


def _images_of(session: Session, chosen: sa.Subquery) -> dict[uuid.UUID, Sequence[MealImage]]:
    images: dict[uuid.UUID, list[MealImage]] = {}
    query = sa.select(MealImage).join(chosen, chosen.c.id == MealImage.meal_id)
    for image in session.scalars(query):
        images.setdefault(image.meal_id, []).append(image)
    return dict(images)
