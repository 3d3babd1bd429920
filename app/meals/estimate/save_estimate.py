"""Save the pipeline's answer in one transaction: run, artefacts, items, candidates, effective records.

Only the meal's status is updated: a run is written once, under its job's id, and saving it again
changes nothing. Items get the foods of their hints, or those that the index is sure of.

The run of a remeasurement is saved on top of the old run, if no person's statement would lose what
it refers to. The items that both runs have keep their ids, foods and events; they get the new run's
outlines and volumes. Items that only the old run has are replaced, those that only the new one has
are added. Otherwise the meal stays as it is, and the run is kept beside it.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import cast

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.candidates.item_candidates import save_candidates
from app.core.errors import Failure
from app.foods import queries as foods
from app.foods.models import Food
from app.jobs import queries as jobs
from app.meals.stored import queries as meals
from app.meals.stored.item_state import REPLACED, pipeline_measure
from app.meals.stored.job_models import RERUN_OF, Job, JobPurpose, RemeasuredItem, RemeasuredPair
from app.meals.stored.meal_parts import FROM_HINT, MealParts, parts_of, records_of
from app.meals.stored.models import HintDetails, Meal
from app.meals.stored.queries import WAITING
from app.meals.stored.record_models import (
    HintedLeftover,
    Item,
    ItemCandidate,
    ItemFood,
    ItemMeasure,
    ItemOrigin,
    Run,
    RunArtefact,
)
from app.meals.stored.run_answer import ItemAnswer, RunAnswer
from app.records.item_foods import item_food, weighing_for
from app.records.match_items import MatchedItems, match_rerun
from app.records.project_records import project_meal
from app.records.review.remeasure import measure_of, save_measures

# drawn once; item ids are derived under it
ITEM_NAMESPACE = uuid.UUID("3f2ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e")

Numbered = Sequence[tuple[int, ItemAnswer]]  # items of an answer with their positions in it


def save_served(session: Session, meal: Meal, run_id: uuid.UUID, answers: Numbered) -> None:
    """Save items of the meal's own pair, with the foods of their hints, else those that the index is sure of."""
    items = [_item_row(meal.id, run_id, position, answer) for position, answer in answers]
    hints = _hint_of_each(answers, meal.details["hints"])
    _save_items(session, meal, items, hints)
    seen = [(item, answer) for item, (_, answer) in zip(items, answers, strict=True)]
    likely = save_candidates(session, run_id, seen)
    for item, hint, food in zip(items, hints, likely, strict=True):
        row = (
            _food_assignment(session, meal, item, food, hint.get("lies_as"))
            if "food" not in hint
            else None
        )
        if row is not None:
            session.add(row)


def save_left(session: Session, meal: Meal, run_id: uuid.UUID, answers: Numbered) -> None:
    """Save items of the after-meal pair.

    They are matched to the meal's items when the meal is projected.
    """
    items = [_item_row(meal.id, run_id, position, answer, "after") for position, answer in answers]
    hints = _hint_of_each(answers, after_hints(meal))
    for item, hint in zip(items, hints, strict=True):
        item.traits = {**item.traits, "told": _hinted_leftover(hint)}
    _save_items(session, meal, items, hints)


def after_hints(meal: Meal) -> list[HintDetails]:
    """Return the hints of the after-meal pair, as the phone sent them."""
    return meal.after_details["hints"] if meal.after_details is not None else []


def _item_row(
    meal_id: uuid.UUID,
    run_id: uuid.UUID,
    position: int,
    answer: ItemAnswer,
    origin: ItemOrigin = "pipeline",
) -> Item:
    """Return the row of an item of the answer.

    Its id follows from run and position, so a rebuilt row has the same.
    """
    return Item(
        id=uuid.uuid5(ITEM_NAMESPACE, f"{run_id}/{position}"),
        meal_id=meal_id,
        run_id=run_id,
        origin=origin,
        position=position,
        traits=answer.traits,
        **answer.columns(),
    )


def _hinted_leftover(hint: HintDetails) -> HintedLeftover:
    hinted: HintedLeftover = {}
    if "item" in hint:
        hinted["item"] = hint["item"]
    if "class" in hint:
        hinted["class"] = hint["class"]
    return hinted


def _hint_of_each(answers: Numbered, hints: Sequence[HintDetails]) -> list[HintDetails]:
    """Return the hint that each item answers; empty if it answers none."""
    return [hints[item.hint] if item.hint is not None else {} for _, item in answers]


def _save_items(
    session: Session, meal: Meal, items: Sequence[Item], hints: Sequence[HintDetails]
) -> None:
    """Save items with the foods of their hints."""
    session.add_all(items)
    session.flush()
    chosen = _chosen_foods(session, hints)
    session.add_all(
        ItemCandidate(
            item_id=item.id, position=0, food_id=food.id, probability=None, source=FROM_HINT
        )
        for item, food in zip(items, chosen, strict=True)
        if food is not None
    )
    assignments = [
        _food_assignment(session, meal, item, food, hint.get("lies_as"))
        for item, food, hint in zip(items, chosen, hints, strict=True)
    ]
    session.add_all(row for row in assignments if row is not None)


def _chosen_foods(session: Session, hints: Sequence[HintDetails]) -> list[Food | None]:
    """Return the food of each item's hint; None without a hint or if no table has the food."""
    keys = {hint["food"] for hint in hints if "food" in hint}
    foods_by_key = foods.foods_by_key(session, keys) if keys else {}
    return [foods_by_key.get(hint.get("food", "")) for hint in hints]


def _food_assignment(
    session: Session, meal: Meal, item: Item, food: Food | None, lies_as: str | None
) -> ItemFood | None:
    if food is None:
        return None
    return item_food(item.id, food.id, weighing_for(session, food, meal.study_id, lies_as), lies_as)


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
    """Decide whether the meal's records may rest on the answer.

    The meal is locked by the caller.
    """
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
        meal.pair("meal").set_failure(None)
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
    meal.pair("after").set_failure(None)


@dataclass(frozen=True, slots=True)
class _Figures:
    """The compared figures of an item.

    volume: ml, with its interval; mass_g: of the record, as served
    """

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


def save_estimate(session: Session, job_id: uuid.UUID, answer: RunAnswer, result_key: str) -> None:
    """Write a run's answer, whose artefacts have their blob keys."""
    job = session.get_one(Job, job_id)
    if session.get(Run, job_id) is not None:
        return  # saved before: the worker died between commit and report, and the job ran again
    meal = meals.lock_meal(session, job.meal_id)
    if meal is None:
        return  # the meal was erased while it was estimated
    now, failure = datetime.now(UTC), answer.failure
    rerun = judge_rerun(session, job, meal, answer) if job.purpose in RERUN_OF else None
    session.add(
        Run(
            id=job_id,
            meal_id=meal.id,
            purpose=rerun.purpose if rerun is not None else job.purpose,
            remeasurement_id=rerun.remeasurement_id if rerun is not None else None,
            method=answer.method,
            pipeline_version=answer.pipeline_version,
            marker=answer.marker,
            camera={"left": answer.camera, answer.second: answer.camera_right}
            if answer.camera
            else None,
            parameters=answer.parameters,
            colour=answer.colour,
            stages=answer.stages,
            seconds=answer.seconds,
            food_releases=[
                f"{release.name} {release.version}" for release in foods.releases_in_force(session)
            ],
            failure_code=failure.code if failure is not None else None,
            failure_message=failure.message if failure is not None else None,
            result_key=result_key,
            created_at=now,
        )
    )
    session.flush()
    session.add_all(
        RunArtefact(run_id=job_id, **artefact.model_dump()) for artefact in answer.artefacts
    )
    if rerun is not None:
        save_rerun(session, rerun, meal, job_id, answer)
        return
    if job.purpose == "remeasure":
        save_measures(session, job, meal, answer)
    elif job.purpose == "after":
        save_left(session, meal, job_id, list(enumerate(answer.items)))
        left_failure = failure_of_after(meal, answer)
        if left_failure is None:
            settle_after(meal)
        else:
            meal.pair("after").set_status("failed")
            meal.pair("after").set_failure(left_failure)
    else:
        save_served(session, meal, job_id, list(enumerate(answer.items)))
        meal.stage = None
        if failure is not None:
            meal.pair("meal").set_failure(failure)
    project_meal(session, meal)
