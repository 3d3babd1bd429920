"""Save the pipeline's answer in one transaction: run, artefacts, items, candidates, effective records.

Only the meal's status is updated: a run is written once, under its job's id, and saving it again changes nothing.
"""

import uuid
from collections.abc import Sequence
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.candidates.save_candidates import save_candidates
from app.foods import queries as foods
from app.foods.models import Food
from app.meals import queries as meals
from app.meals.job_models import Job
from app.meals.meal_parts import FROM_HINT
from app.meals.models import HintDetails, Meal
from app.meals.outline_json import rings_of
from app.meals.record_models import HintedLeftover, Item, ItemCandidate, ItemFood, ItemOrigin, Run, RunArtefact
from app.meals.run_answer import ItemAnswer, RunAnswer
from app.records.item_foods import item_food, weighing_for
from app.records.project_records import project_meal
from app.records.review.remeasure import save_measures

ITEM_NAMESPACE = uuid.UUID("3f2ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e")  # drawn once; item ids are derived under it
NOTHING_THERE = "no_food_found"  # the after-meal pair then shows an empty plate: no failure


def save_estimate(session: Session, job_id: uuid.UUID, answer: RunAnswer, result_key: str) -> None:
    """Write a run's answer, whose artefacts have their blob keys."""
    job = session.get_one(Job, job_id)
    if session.get(Run, job_id) is not None:
        return  # saved before: the worker died between commit and report, and the job ran again
    meal = meals.lock_meal(session, job.meal_id)
    if meal is None:
        return  # the meal was erased while it was estimated
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


def item_row(
    meal_id: uuid.UUID, run_id: uuid.UUID, position: int, answer: ItemAnswer, origin: ItemOrigin = "pipeline"
) -> Item:
    """Return the row of an item of the answer. Its id follows from run and position, so a rebuilt row has the same."""
    low_ml, high_ml = answer.interval_ml
    return Item(
        id=uuid.uuid5(ITEM_NAMESPACE, f"{run_id}/{position}"),
        meal_id=meal_id,
        run_id=run_id,
        origin=origin,
        position=position,
        rings=rings_of(answer.polygon),
        volume_ml=answer.volume_ml,
        volume_low_ml=low_ml,
        volume_high_ml=high_ml,
        relative_sd=answer.relative_sd,
        flags=answer.flags,
        traits=answer.traits,
    )


def _save_meal(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    """Save the items of the meal's own pair, with the foods of their hints, else those that the index is sure of."""
    failure = answer.failure
    items = [item_row(meal.id, run_id, position, item) for position, item in enumerate(answer.items)]
    hints = _hint_of_each(answer, meal.details["hints"])
    _save_items(session, meal, items, hints)
    likely = save_candidates(session, run_id, list(zip(items, answer.items, strict=True)))
    for item, hint, food in zip(items, hints, likely, strict=True):
        row = _food_assignment(session, meal, item, food, hint.get("lies_as")) if "food" not in hint else None
        if row is not None:
            session.add(row)
    if failure is not None:
        meal.failure_code, meal.failure_message, meal.failure_advice = failure.code, failure.message, failure.advice
    meal.stage = None


def _save_after(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    """Save the items of the after-meal pair. They are matched to the meal's items when the meal is projected."""
    failure = answer.failure
    items = [item_row(meal.id, run_id, position, item, "after") for position, item in enumerate(answer.items)]
    hints = _hint_of_each(answer, after_hints(meal))
    for item, hint in zip(items, hints, strict=True):
        item.traits = {**item.traits, "told": _hinted_leftover(hint)}
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


def _hinted_leftover(hint: HintDetails) -> HintedLeftover:
    hinted: HintedLeftover = {}
    if "item" in hint:
        hinted["item"] = hint["item"]
    if "class" in hint:
        hinted["class"] = hint["class"]
    return hinted


def _hint_of_each(answer: RunAnswer, hints: Sequence[HintDetails]) -> list[HintDetails]:
    """Return the hint that each item answers; empty if it answers none."""
    return [hints[item.hint] if item.hint is not None else {} for item in answer.items]


def _save_items(session: Session, meal: Meal, items: Sequence[Item], hints: Sequence[HintDetails]) -> None:
    """Save items with the foods of their hints."""
    session.add_all(items)
    session.flush()
    chosen = _chosen_foods(session, hints)
    session.add_all(
        ItemCandidate(item_id=item.id, position=0, food_id=food.id, probability=None, source=FROM_HINT)
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
