"""The pipeline's answer into the database, in one transaction: run, artefacts, items, candidates, effective records.

Nothing is updated but the meal's status: a run is written once, under its job's id, and a second save of it is nothing.
"""

import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.orm import Session

from app.candidates.save_candidates import save_candidates
from app.foods import queries as foods
from app.foods.models import Food
from app.meals import queries as meals
from app.meals.job_models import Job
from app.meals.meal_parts import FROM_HINT
from app.meals.models import HintDetails, Meal
from app.meals.outline_json import rings_of
from app.meals.record_models import Item, ItemCandidate, ItemFood, Run, RunArtefact
from app.meals.run_answer import ItemAnswer, RunAnswer
from app.records.item_foods import item_food, weighing_for
from app.records.project_records import project_meal
from app.records.review.remeasure import save_measures

ITEM_NAMESPACE = uuid.UUID("3f2ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e")  # drawn once; item ids are derived under it
NOTHING_THERE = "no_food_found"  # of the after-meal pair that is an answer: the plate is empty


def save_estimate(session: Session, job_id: uuid.UUID, answer: RunAnswer, result_key: str) -> None:
    """Write what a run found. answer: with the blob keys of its artefacts."""
    job = session.get_one(Job, job_id)
    if session.get(Run, job_id) is not None:
        return  # saved before: the job ran again after its worker died between commit and report
    meal = meals.lock_meal(session, job.meal_id)
    if meal is None:
        return  # the meal went while it was estimated: nothing of it may come back
    now, failure = datetime.now(UTC), answer.failure
    session.add(
        Run(
            id=job_id,
            meal_id=meal.id,
            purpose=job.purpose,
            method=answer.method,
            pipeline_version=answer.pipeline_version,
            marker=answer.marker,
            camera={"left": answer.camera, "right": answer.camera_right} if answer.camera else None,
            parameters=answer.parameters,
            colour=answer.colour,
            stages=answer.stages,
            seconds=answer.seconds,
            food_releases=[f"{release.name} {release.version}" for release in foods.releases_in_force(session)],
            failure_code=failure.code if failure is not None else None,
            failure_message=failure.message if failure is not None else None,
            result_key=result_key,
            created_at=now,
        )
    )
    session.flush()
    session.add_all(RunArtefact(run_id=job_id, **artefact.model_dump()) for artefact in answer.artefacts)
    if job.purpose == "remeasure":
        save_measures(session, job, meal, answer)
    elif job.purpose == "after":
        _save_after(session, meal, job_id, answer)
    else:
        _save_meal(session, meal, job_id, answer)
    project_meal(session, meal)


def item_row(meal_id: uuid.UUID, run_id: uuid.UUID, position: int, found: ItemAnswer, origin: str = "pipeline") -> Item:
    """An item of the answer as a row; its id follows from run and position, so building it again gives the same."""
    low_ml, high_ml = found.interval_ml
    return Item(
        id=uuid.uuid5(ITEM_NAMESPACE, f"{run_id}/{position}"),
        meal_id=meal_id,
        run_id=run_id,
        origin=origin,
        position=position,
        rings=rings_of(found.polygon),
        volume_ml=found.volume_ml,
        volume_low_ml=low_ml,
        volume_high_ml=high_ml,
        relative_sd=found.relative_sd,
        flags=found.flags,
        traits=found.traits,
    )


def _save_meal(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    """What was found in the meal's own pair: its items, what the hints say they are, else what the index is sure of."""
    failure = answer.failure
    items = [item_row(meal.id, run_id, position, found) for position, found in enumerate(answer.items)]
    hints = _answered(answer, meal.details["hints"])
    _save_items(session, meal, items, hints)
    likely = save_candidates(session, run_id, list(zip(items, answer.items, strict=True)))
    for item, hint, food in zip(items, hints, likely, strict=True):
        row = _taken_for(session, meal, item, food, hint.get("lies_as")) if "food" not in hint else None
        if row is not None:
            session.add(row)
    if failure is not None:
        meal.failure_code, meal.failure_message, meal.failure_advice = failure.code, failure.message, failure.advice
    meal.stage = None


def _save_after(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    """What was found in the after-meal pair. What it is of which item is matched when the meal is projected."""
    failure = answer.failure
    items = [item_row(meal.id, run_id, position, found, "after") for position, found in enumerate(answer.items)]
    hints = _answered(answer, after_hints(meal))
    for item, hint in zip(items, hints, strict=True):
        item.traits = item.traits | {"told": {key: hint[key] for key in ("item", "class") if key in hint}}
    _save_items(session, meal, items, hints)
    if failure is not None and (failure.code != NOTHING_THERE or after_hints(meal)):
        meal.after_status = "failed"
        meal.after_failure_code, meal.after_failure_message = failure.code, failure.message
        meal.after_failure_advice = failure.advice
        return
    meal.after_status, meal.after_due_at = "estimated", None
    meal.after_failure_code = meal.after_failure_message = meal.after_failure_advice = None


def after_hints(meal: Meal) -> list[HintDetails]:
    """Return the hints of the after-meal pair, as the phone sent them."""
    return meal.after_details["hints"] if meal.after_details is not None else []


def _answered(answer: RunAnswer, hints: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The hint that each item answers, empty where it answers none."""
    return [hints[item.hint] if item.hint is not None else {} for item in answer.items]


def _save_items(session: Session, meal: Meal, items: Sequence[Item], hints: Sequence[Mapping[str, Any]]) -> None:
    """Write items, and what their hints say they are."""
    session.add_all(items)
    session.flush()
    chosen = _chosen_foods(session, hints)
    session.add_all(
        ItemCandidate(item_id=item.id, position=0, food_id=food.id, probability=None, source=FROM_HINT)
        for item, food in zip(items, chosen, strict=True)
        if food is not None
    )
    taken_for = [
        _taken_for(session, meal, item, food, hint.get("lies_as"))
        for item, food, hint in zip(items, chosen, hints, strict=True)
    ]
    session.add_all(row for row in taken_for if row is not None)


def _chosen_foods(session: Session, hints: Sequence[Mapping[str, Any]]) -> list[Food | None]:
    """The food of each item's hint; None without a hint or where the tables lack the food."""
    keys = {hint["food"] for hint in hints if "food" in hint}
    known = foods.foods_by_key(session, keys) if keys else {}
    return [known.get(hint.get("food", "")) for hint in hints]


def _taken_for(session: Session, meal: Meal, item: Item, food: Food | None, lies_as: str | None) -> ItemFood | None:
    if food is None:
        return None
    return item_food(item.id, food.id, weighing_for(session, food, meal.study_id, lies_as), lies_as)
