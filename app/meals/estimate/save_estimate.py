"""Save the pipeline's answer in one transaction: run, artefacts, items, candidates, effective records.

Only the meal's status is updated: a run is written once, under its job's id, and saving it again changes nothing.
"""

import uuid
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.meals.estimate.save_items import save_left, save_served
from app.meals.estimate.save_rerun import failure_of_after, judge_rerun, save_rerun, settle_after
from app.meals.stored import queries as meals
from app.meals.stored.job_models import RERUN_OF, Job
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Run, RunArtefact
from app.meals.stored.run_answer import RunAnswer
from app.records.project_records import project_meal
from app.records.review.remeasure import save_measures


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
        _save_after(session, meal, job_id, answer)
    else:
        _save_meal(session, meal, job_id, answer)
    project_meal(session, meal)


def _save_meal(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    save_served(session, meal, run_id, list(enumerate(answer.items)))
    failure = answer.failure
    if failure is not None:
        meal.failure_code, meal.failure_message, meal.failure_advice = (
            failure.code,
            failure.message,
            failure.advice,
        )
    meal.stage = None


def _save_after(session: Session, meal: Meal, run_id: uuid.UUID, answer: RunAnswer) -> None:
    save_left(session, meal, run_id, list(enumerate(answer.items)))
    failure = failure_of_after(meal, answer)
    if failure is not None:
        meal.after_status = "failed"
        meal.after_failure_code, meal.after_failure_message = failure.code, failure.message
        meal.after_failure_advice = failure.advice
        return
    settle_after(meal)
