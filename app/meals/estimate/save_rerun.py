"""Save the run of a remeasurement: on top of the old run, if no person's statement would lose what it refers to.

The items that both runs have keep their ids, foods and events; they get the new run's outlines and volumes. Items that
only the old run has are replaced, those that only the new one has are added. Otherwise the meal stays as it is, and the
run is kept beside it.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import cast

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.candidates.item_candidates import save_candidates
from app.core.errors import Failure
from app.jobs import queries as jobs
from app.meals.estimate.save_items import after_hints, save_left, save_served
from app.meals.stored.item_state import REPLACED, pipeline_measure
from app.meals.stored.job_models import RERUN_OF, Job, JobPurpose
from app.meals.stored.meal_parts import MealParts, parts_of, records_of
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING
from app.meals.stored.record_models import Item, ItemMeasure
from app.meals.stored.remeasurement_models import RemeasuredItem, RemeasuredPair
from app.meals.stored.run_answer import RunAnswer
from app.records.match_rerun import MatchedItems, match_rerun
from app.records.project_records import project_meal
from app.records.review.remeasure import measure_of

NOTHING_THERE = "no_food_found"  # the after-meal pair then shows an empty plate: no failure
WAITS = "waits_for_estimate"  # reason to keep: another run of the pair is to come


@dataclass(frozen=True, slots=True)
class Rerun:
    """A run of a remeasurement, judged before it is saved. purpose: of its run."""

    row: RemeasuredPair
    parts: MealParts
    items: MatchedItems

    @property
    def remeasurement_id(self) -> uuid.UUID:
        """The remeasurement that it belongs to."""
        return self.row.remeasurement_id

    @property
    def purpose(self) -> JobPurpose:
        """The purpose of its run: that of a kept one makes it count for nothing."""
        if self.items.keep is None:
            return self.row.pair
        return cast(
            "JobPurpose",
            next(purpose for purpose, pair in RERUN_OF.items() if pair == self.row.pair),
        )


def judge_rerun(session: Session, job: Job, meal: Meal, answer: RunAnswer) -> Rerun:
    """Decide whether the meal's records may rest on the answer. The meal is locked by the caller."""
    row = session.scalars(sa.select(RemeasuredPair).where(RemeasuredPair.job_id == job.id)).one()
    parts = parts_of(session, [meal])[0]
    failure = failure_of_after(meal, answer) if row.pair == "after" else answer.failure
    if jobs.pair_status(meal, row.pair) in WAITING:
        items = MatchedItems(keep=WAITS)
    elif failure is not None:
        items = MatchedItems(keep=failure.code)
    else:
        items = match_rerun(parts, row.pair, answer.items)
    return Rerun(row, parts, items)


def save_rerun(
    session: Session, rerun: Rerun, meal: Meal, run_id: uuid.UUID, answer: RunAnswer
) -> None:
    """Save what was judged; the run is in the session. A kept run changes nothing of the meal."""
    rerun.row.state, rerun.row.reason = (
        ("measured", None) if rerun.items.keep is None else ("kept", rerun.items.keep)
    )
    rerun.row.ended_at = datetime.now(UTC)
    if rerun.items.keep is not None:
        return
    before = _figures(session, rerun.parts)
    matched = [(item, answer.items[place]) for item, place in rerun.items.matched]
    session.add_all(measure_of(item, run_id, item_answer) for item, item_answer in matched)
    session.add_all(_replaced(item, run_id) for item in rerun.items.replaced)
    added = [(place, answer.items[place]) for place in rerun.items.added]
    if rerun.row.pair == "meal":
        save_candidates(session, run_id, matched)
        save_served(session, meal, run_id, added)
        meal.failure_code = meal.failure_message = meal.failure_advice = None
    else:
        save_left(session, meal, run_id, added)
        settle_after(meal)
    project_meal(session, meal)
    after = _figures(session, parts_of(session, [meal])[0])
    touched = {item.id for item, _ in matched} | {item.id for item in rerun.items.replaced}
    touched |= after.keys() - before.keys()
    session.add_all(
        _compared(
            rerun.remeasurement_id,
            item_id,
            before.get(item_id, NOTHING),
            after.get(item_id, NOTHING),
        )
        for item_id in sorted(touched)
    )


def failure_of_after(meal: Meal, answer: RunAnswer) -> Failure | None:
    """Return the failure of an after-meal pair's run; an empty plate is none, unless the phone hinted at leftovers."""
    failure = answer.failure
    return (
        None
        if failure is None or (failure.code == NOTHING_THERE and not after_hints(meal))
        else failure
    )


def settle_after(meal: Meal) -> None:
    """Set the state of an after-meal pair that was measured."""
    meal.after_status, meal.after_due_at = "estimated", None
    meal.after_failure_code = meal.after_failure_message = meal.after_failure_advice = None


@dataclass(frozen=True, slots=True)
class _Figures:
    """The compared figures of an item. volume: ml, with its interval; mass_g: of the record, as served."""

    volume: tuple[float | None, float | None, float | None] = (None, None, None)
    mass_g: float | None = None
    relative_sd: Mapping[str, float] | None = None
    flags: tuple[str, ...] = ()


NOTHING = _Figures()


def _figures(session: Session, parts: MealParts) -> dict[uuid.UUID, _Figures]:
    """Return item -> its figures, of the items that runs found."""
    grams: dict[uuid.UUID, float | None] = {
        item_id: record.mass_g for item_id, record in records_of(session, parts.meal.id).items()
    }
    grams |= {uuid.UUID(piece["id"]): piece["mass_g"] for piece in parts.meal.leftovers}
    figures = {}
    for item in parts.items:
        if item.run_id is None:
            continue
        row = pipeline_measure(parts, item)
        volume = (row.volume_ml, row.volume_low_ml, row.volume_high_ml)
        figures[item.id] = _Figures(volume, grams.get(item.id), row.relative_sd, tuple(row.flags))
    return figures


def _compared(
    remeasurement_id: uuid.UUID, item_id: uuid.UUID, old: _Figures, new: _Figures
) -> RemeasuredItem:
    return RemeasuredItem(
        remeasurement_id=remeasurement_id,
        item_id=item_id,
        old_volume_ml=old.volume[0],
        old_low_ml=old.volume[1],
        old_high_ml=old.volume[2],
        new_volume_ml=new.volume[0],
        new_low_ml=new.volume[1],
        new_high_ml=new.volume[2],
        old_mass_g=old.mass_g,
        new_mass_g=new.mass_g,
        is_changed=old != new,
    )


def _replaced(item: Item, run_id: uuid.UUID) -> ItemMeasure:
    return ItemMeasure(
        item_id=item.id, run_id=run_id, rings=item.rings, relative_sd={}, flags=[REPLACED]
    )
