"""SQL of remeasurements: the pairs that one takes or skips, its progress, and the table of old and new volumes."""

import uuid
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.children.faults import CANCELLED, PHOTOGRAPH_ERASED
from app.core.errors import NotFoundError
from app.foods.models import Food
from app.meals.stored.job_models import (
    PairPurpose,
    PairState,
    RemeasuredItem,
    RemeasuredPair,
    Remeasurement,
)
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.queries import WAITING
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Participant
from app.photos.slots import AFTER_SLOTS
from app.records.remeasurements.schemas import ComparedItemOut, RemeasurementOut, Selection

NO_PHOTOGRAPHS = "no_photographs"  # reasons to skip a pair, beside the codes of faults.py
INCOMPLETE = "incomplete"
WAITS = "waits_for_estimate"
WITHDRAWN = "withdrawn"
NOTHING_LEFT = "nothing_left"


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
    """Return the pairs that a remeasurement would take, in its order.

    Raises NotFoundError as chosen_meals.
    """
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
    status, slots = meal.pair(pair).status, meal.pair(pair).slots
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
    if status == "failed" and meal.pair(pair).failure_code == CANCELLED.code:
        return CANCELLED.code
    return NOTHING_LEFT if status == NOTHING_LEFT else None


def _images_of(session: Session, chosen: sa.Subquery) -> dict[uuid.UUID, Sequence[MealImage]]:
    images: dict[uuid.UUID, list[MealImage]] = {}
    query = sa.select(MealImage).join(chosen, chosen.c.id == MealImage.meal_id)
    for image in session.scalars(query):
        images.setdefault(image.meal_id, []).append(image)
    return dict(images)


# position of the meal, pair, item; NO_ITEM: a pair without items
RowKey = tuple[int, str, uuid.UUID]
FIGURES = (
    *("old_volume_ml", "old_low_ml", "old_high_ml", "new_volume_ml", "new_low_ml", "new_high_ml"),
    *("old_mass_g", "new_mass_g", "is_changed"),
)
NO_ITEM = uuid.UUID(int=0)


def insert_pairs(session: Session, remeasurement: Remeasurement, selection: Selection) -> None:
    """Insert the selection's pairs, all pending. Raises NotFoundError as chosen_meals."""
    chosen = chosen_meals(session, remeasurement.study_id, selection)
    own_id, pending = sa.literal(remeasurement.id, sa.Uuid()), sa.literal("pending")
    of_meal = sa.select(own_id, chosen.c.id, sa.literal("meal"), chosen.c.position, pending)
    of_after = (
        sa.select(own_id, Meal.id, sa.literal("after"), chosen.c.position, pending)
        .join(chosen, chosen.c.id == Meal.id)
        .where(has_after_pair())
    )
    columns = ["remeasurement_id", "meal_id", "pair", "position", "state"]
    for query in (of_meal, of_after):
        session.execute(sa.insert(RemeasuredPair).from_select(columns, query))


def find_remeasurement(
    session: Session, study_id: uuid.UUID, remeasurement_id: uuid.UUID, *, lock: bool = False
) -> Remeasurement | None:
    """Return a study's remeasurement, locked until commit if `lock` is set."""
    query = sa.select(Remeasurement).where(
        Remeasurement.id == remeasurement_id, Remeasurement.study_id == study_id
    )
    query = query.with_for_update().execution_options(populate_existing=True) if lock else query
    return session.scalars(query).one_or_none()


def unfinished_of_study(session: Session, study_id: uuid.UUID) -> list[Remeasurement]:
    """Return a study's remeasurements that are running or stopped, locked, the running one first, then the newest."""
    query = (
        sa.select(Remeasurement)
        .where(Remeasurement.study_id == study_id, Remeasurement.state.in_(("running", "stopped")))
        .order_by(Remeasurement.state, Remeasurement.created_at.desc(), Remeasurement.id)
    )
    return list(session.scalars(query.with_for_update()))


def running_ids(session: Session) -> list[uuid.UUID]:
    """Return the remeasurements that are running, the oldest first."""
    query = sa.select(Remeasurement.id).where(Remeasurement.state == "running")
    return list(session.scalars(query.order_by(Remeasurement.created_at, Remeasurement.id)))


def lock_running(session: Session, remeasurement_id: uuid.UUID) -> Remeasurement | None:
    """Return a running remeasurement, locked; None: it was stopped, or another process has it."""
    query = sa.select(Remeasurement).where(
        Remeasurement.id == remeasurement_id, Remeasurement.state == "running"
    )
    return session.scalars(query.with_for_update(skip_locked=True)).one_or_none()


def open_pairs(
    session: Session, remeasurement_id: uuid.UUID, state: PairState, limit: int | None = None
) -> list[RemeasuredPair]:
    """Return pairs that are pending or queued, in their order."""
    query = (
        sa.select(RemeasuredPair)
        .where(RemeasuredPair.remeasurement_id == remeasurement_id, RemeasuredPair.state == state)
        .order_by(RemeasuredPair.position, RemeasuredPair.pair.desc())
        .limit(limit)
    )
    return list(session.scalars(query))


def reopen_pair(session: Session, job_id: uuid.UUID) -> None:
    """Make the pair of a job that was stopped pending again."""
    query = sa.update(RemeasuredPair).where(RemeasuredPair.job_id == job_id)
    session.execute(query.values(state="pending", job_id=None))


def page_of_remeasurements(
    session: Session, study_id: uuid.UUID, *, after: tuple[datetime, uuid.UUID] | None, limit: int
) -> list[Remeasurement]:
    """Return at most `limit` remeasurements of a study after `after`, the newest first."""
    query = sa.select(Remeasurement).where(Remeasurement.study_id == study_id)
    if after is not None:
        query = query.where(sa.tuple_(Remeasurement.created_at, Remeasurement.id) < after)
    query = query.order_by(Remeasurement.created_at.desc(), Remeasurement.id.desc()).limit(limit)
    return list(session.scalars(query))


def progress_of(
    session: Session, remeasurements: Sequence[Remeasurement]
) -> list[RemeasurementOut]:
    """Return the remeasurements with their progress."""
    pair, item = RemeasuredPair, RemeasuredItem
    ids = [remeasurement.id for remeasurement in remeasurements]
    states: dict[uuid.UUID, Counter[str]] = {
        remeasurement_id: Counter() for remeasurement_id in ids
    }
    reasons: dict[uuid.UUID, Counter[str]] = {
        remeasurement_id: Counter() for remeasurement_id in ids
    }
    counted = (
        sa.select(pair.remeasurement_id, pair.state, pair.reason, sa.func.count())
        .where(pair.remeasurement_id.in_(ids))
        .group_by(pair.remeasurement_id, pair.state, pair.reason)
    )
    for remeasurement_id, state, reason, count in session.execute(counted):
        states[remeasurement_id][state] += count
        if reason is not None:
            reasons[remeasurement_id][reason] += count
    is_changed = sa.func.sum(sa.cast(item.is_changed, sa.Integer))
    compared = (
        sa.select(item.remeasurement_id, sa.func.count(), is_changed)
        .where(item.remeasurement_id.in_(ids))
        .group_by(item.remeasurement_id)
    )
    items = {row[0]: (row[1], int(row[2])) for row in session.execute(compared)}
    outs = []
    for remeasurement in remeasurements:
        by_state = states[remeasurement.id]
        compared_items, changed_items = items.get(remeasurement.id, (0, 0))
        out = RemeasurementOut(
            id=remeasurement.id,
            state=remeasurement.state,
            author=remeasurement.author,
            pipeline_version=remeasurement.pipeline_version,
            created_at=remeasurement.created_at,
            ended_at=remeasurement.ended_at,
            pairs=by_state.total(),
            waiting=by_state["pending"] + by_state["queued"],
            measured=by_state["measured"],
            kept=by_state["kept"],
            skipped=by_state["skipped"],
            reasons=dict(sorted(reasons[remeasurement.id].items())),
            items=compared_items,
            items_changed=changed_items,
        )
        outs.append(out)
    return outs


def page_of_rows(
    session: Session, remeasurement_id: uuid.UUID, *, after: RowKey | None, limit: int
) -> list[tuple[RowKey, ComparedItemOut]]:
    """Return at most `limit` rows of the table after `after`, each with its key.

    By meal, its own pair first, then by item.
    """
    pair, item = RemeasuredPair, RemeasuredItem
    is_of_pair = sa.and_(
        Item.meal_id == pair.meal_id,
        (Item.origin == "after") == (pair.pair == "after"),
        pair.state == "measured",
    )
    query = (
        sa.select(pair, Participant.code, Meal.client_id, Meal.captured_at, item, Food.key)
        .join(Meal, Meal.id == pair.meal_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .outerjoin(
            sa.join(item, Item, Item.id == item.item_id),
            sa.and_(item.remeasurement_id == pair.remeasurement_id, is_of_pair),
        )
        .outerjoin(EffectiveRecord, EffectiveRecord.item_id == item.item_id)
        .outerjoin(Food, Food.id == EffectiveRecord.food_id)
        .where(pair.remeasurement_id == remeasurement_id)
        .order_by(pair.position, pair.pair.desc(), item.item_id)
        .limit(limit)
    )
    if after is not None:
        position, purpose, item_id = after
        is_later = sa.or_(
            pair.pair < purpose, sa.and_(pair.pair == purpose, item.item_id > item_id)
        )
        query = query.where(
            sa.or_(pair.position > position, sa.and_(pair.position == position, is_later))
        )
    rows: list[tuple[RowKey, ComparedItemOut]] = []
    for row, participant, meal, captured_at, compared, food in session.execute(query):
        item_id = compared.item_id if compared is not None else None
        out = ComparedItemOut(
            participant=participant,
            meal_id=meal,
            captured_at=captured_at,
            pair=row.pair,
            state=row.state,
            reason=row.reason,
            item_id=item_id,
            food=food,
            **{name: getattr(compared, name, None) for name in FIGURES},
        )
        rows.append(((row.position, row.pair, item_id or NO_ITEM), out))
    return rows
