"""The work of a job: fetch the sealed photographs, estimate in a child, seal the answer; then save it exactly once.

Used by job_runner.py, which calls `compute`, then `load`, and `save` in the transaction that ends
the job.
"""

import hashlib
import tempfile
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy.exc
import structlog
from sqlalchemy.orm import Session

from app.candidates.classify import ClassifyFoods
from app.candidates.identify import IdentifyFoods
from app.children.child_pool import (
    ChildCancelledError,
    ChildPool,
    ChildRequest,
    ChildResult,
)
from app.children.faults import CANCELLED, PHOTOGRAPH_ERASED, BrokenOff, JobFailure
from app.core.errors import Failure
from app.core.logs import bind_log_context
from app.core.settings import Settings
from app.db.session import Database
from app.foods import queries as foods
from app.identification.food_index import FoodIndex, shipped_index
from app.meals.estimate.camera_choice import ChosenCamera, choose_camera, choose_rig
from app.meals.estimate.estimate_json import (
    answer_of,
    hint_from_json,
    options_to_json,
    scale_by,
    with_forms,
)
from app.meals.estimate.save_estimate import save_estimate
from app.meals.stored import queries as meals
from app.meals.stored.job_models import RERUN_OF, Job
from app.meals.stored.models import Meal, MealImage, PairDetails
from app.meals.stored.receive_photo import sha256_of_file
from app.meals.stored.run_answer import RunAnswer
from app.metrics import instruments
from app.people import privacy_queries as privacy
from app.people.models import Study
from app.photos.slots import AFTER_SLOTS, PAIR_SLOTS, VIEW_SLOTS, confidence_slot, depth_slot
from app.records.project_records import project_meal
from app.records.review.remeasure import Regions, regions_to_measure
from app.storage.blob_store import BlobMissingError, BlobStore
from app.storage.patient_fetcher import PatientFetcher
from app.vessels.meal_vessels import VesselsOfMeal, vessels_of_meal
from app.vision.known_poses import poses_from_mapping
from app.vision.model import EstimateOptions, MealEstimate
from app.vision.rig import StereoRig
from app.vision.version import PIPELINE_VERSION

log = structlog.get_logger()

# of the pipeline; a child has decoded hostile bytes, and each invented name would be a time series for ever
STAGES = frozenset(
    {
        "read",
        "marker",
        "camera",
        "match",
        "rectify",
        "disparity",
        "depth",
        "segment",
        "volume",
        "describe",
    }
)

AWAITS_ROOM = "waits_for_room"  # stage of a meal between two tries of an estimate that was killed or took too long

SCALE_MISSING = Failure(
    "scale_missing",
    "Neither the meal nor its study names a marker, and there is no stereo rig for its photographs, nor their poses.",
    "Ask the people who run the study to name the marker in its settings, or to send the rig again, and to queue the "
    "meal again.",
)
PHOTO_DAMAGED = Failure(
    "photo_damaged",
    "A sealed photograph is no longer what was sealed: the disk or somebody changed it.",
    "Ask the people who run the server to restore it from a backup and to queue the meal again.",
)
PHOTO_MISSING = Failure(
    "photograph_missing",
    "A sealed photograph is no longer in the store.",
    "Ask the people who run the server to restore it from a backup and to queue the meal again.",
)


@dataclass(frozen=True, slots=True)
class SealedAnswer:
    """A pipeline's answer and its key in the store."""

    key: str
    answer: RunAnswer


@dataclass(frozen=True, slots=True)
class _Plan:
    """What a job measures, read in one transaction.

    is_after: the after-meal pair; else the meal's own photographs
    may_identify: whether the foods may be identified
    images: by slot, more than are measured
    views, maps: slots of the photographs and depth maps to measure
    regions: those that a person drew, if the job is of them
    """

    job: Job
    meal: Meal
    study_code: str
    is_after: bool
    may_identify: bool
    images: Mapping[str, MealImage]
    views: Sequence[str]
    maps: Sequence[str]
    options: EstimateOptions
    chosen: ChosenCamera
    library: VesselsOfMeal
    regions: Regions | None


class EstimatePair:
    """The use cases of a worker; one per process.

    may_identify: whether the foods of a meal's own pair may be identified; may raise JobFailure
    """

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        children: ChildPool,
        settings: Settings,
        index: Callable[[], FoodIndex] = shipped_index,
        may_identify: Callable[[Meal], bool] = lambda _meal: True,
    ) -> None:
        self._database = database
        self._identify = IdentifyFoods(database, index)
        self._classify = ClassifyFoods(children, settings)
        self._blobs = blobs
        self._fetcher = PatientFetcher(blobs)
        self._children = children
        self._settings = settings
        self._may_identify = may_identify

    def compute(self, job_id: uuid.UUID, *, is_alone: bool = False) -> str:
        """Run the pipeline and seal its answer and pictures. Returns the answer's blob key.

        is_alone: run while this worker estimates nothing else. Raises BrokenOff, JobFailure.
        """
        plan = self._plan(job_id)
        log.info("estimate_begun", meal_id=str(plan.meal.id), purpose=plan.job.purpose)
        prefix = f"{plan.meal.study_id}/{plan.meal.id}/runs/{job_id}"
        with tempfile.TemporaryDirectory(prefix="tada-", dir=self._blobs.staging_folder()) as name:
            folder = Path(name)
            paths = {
                slot: self._fetch(plan.images[slot], folder) for slot in (*plan.views, *plan.maps)
            }
            try:
                done = self._children.run(
                    self._request(plan, paths, folder),
                    lambda stage: self._note_stage(plan.job, stage),
                    name=str(job_id),
                    is_alone=is_alone,
                )
            except ChildCancelledError:
                raise JobFailure(CANCELLED) from None
            answer = _answer_of(plan, done)
            plan.chosen.note_in(answer)
            plan.library.note_in(answer.parameters)
            if plan.regions is not None:  # of each hint: the meal may have changed when it is saved
                answer.regions = list(plan.regions.items)
            if not plan.may_identify:  # it needs a review: nothing says which foods these are
                for item in answer.items:
                    item.hint = None
            elif not plan.is_after:  # leftovers are of the foods that were served
                self._identify.add_candidates(plan.meal, answer)
                self._classify.add_candidates(plan.study_code, answer, paths[plan.views[0]])
            for artefact in answer.artefacts:
                artefact.blob_key = f"{prefix}/{artefact.name}/{artefact.sha256}"
                self._blobs.put_file(artefact.blob_key, folder / artefact.name)
        result = answer.write()
        result_key = f"{prefix}/result.json/{hashlib.sha256(result).hexdigest()}"
        self._blobs.put_bytes(result_key, result)
        sealed = [result_key, *(artefact.blob_key for artefact in answer.artefacts)]
        self._delete_results_if_erased(plan.meal.id, sealed)
        return result_key

    def load(self, result_key: str) -> SealedAnswer:
        """Read the sealed answer from the store."""
        return SealedAnswer(result_key, RunAnswer.read(self._blobs.read(result_key)))

    def save(self, session: Session, job_id: uuid.UUID, result: SealedAnswer) -> None:
        """Write run, items and records in the session's transaction."""
        save_estimate(session, job_id, result.answer, result.key)
        if result.answer.failure is not None:
            bind_log_context(outcome=result.answer.failure.code)
        # it begins with the study's and the meal's id
        log.info("estimate_saved", result_key=result.key)

    def abandon(self, job_id: uuid.UUID) -> None:
        """End the child that works on the job."""
        if self._children.cancel(str(job_id)):
            log.info("estimate_abandoned", job_id=str(job_id))

    def settle(self, session: Session, meal: Meal) -> None:
        """Update the meal's records after a job that ended without a result."""
        project_meal(session, meal)

    def _delete_results_if_erased(self, meal_id: uuid.UUID, sealed: list[str]) -> None:
        """If the meal or its photographs were erased meanwhile, delete the sealed results as well."""
        with self._database.read() as session:
            if any(image.erased_at is None for image in meals.images_of(session, meal_id)):
                return
        with self._database.write() as session:
            privacy.schedule_deletion(session, sealed, datetime.now(UTC))
        raise JobFailure(PHOTOGRAPH_ERASED)

    def _plan(self, job_id: uuid.UUID) -> _Plan:
        """Read what the job measures. Raises JobFailure (nothing gives the scale)."""
        with self._database.read() as session:
            job = session.get_one(Job, job_id)
            meal = session.get_one(Meal, job.meal_id)
            study = session.get_one(Study, meal.study_id)
            is_after = RERUN_OF.get(job.purpose, job.purpose) == "after"
            views, maps = (AFTER_SLOTS, ()) if is_after else (meal.view_slots, meal.map_slots)
            details = meal.after_details if is_after else meal.details
            images = meals.images_by_slot(session, meal.id)
            # of further views, those that the camera does not fit are left out
            sizes = [(images[slot].width_px, images[slot].height_px) for slot in views]
            has_depth = "left_depth" in maps
            camera = details["camera"] if details is not None else None
            chosen = choose_rig(
                session, meal=meal, study=study, sizes=sizes, has_depth=has_depth
            ) or choose_camera(
                session,
                meal_camera=camera or meal.details["camera"],
                device_id=meal.device_id,
                study=study,
                sizes=sizes[: len(PAIR_SLOTS)],
            )
            regions = regions_to_measure(session, job, meal) if job.purpose == "remeasure" else None
            hints: Sequence[Mapping[str, Any]] = details["hints"] if details is not None else ()
            is_complete = details is not None and details.get("complete", False)
            if regions is not None:
                hints, is_complete = regions.hints, True
            library = vessels_of_meal(session, study.id, hints)
            options = _scale(meal, study, details, chosen.rig, has_depth=has_depth)
            options = replace(
                options,
                camera=chosen.camera,
                vessels=library.models,
                hints=tuple(hint_from_json(hint) for hint in library.in_hints(hints)),
                is_complete=is_complete,
            )
            keys = {hint.food for hint in options.hints if hint.food}
            if keys:
                options = with_forms(options, foods.foods_by_key(session, keys))
            return _Plan(
                job=job,
                meal=meal,
                study_code=study.code,
                is_after=is_after,
                may_identify=job.purpose != "meal" or self._may_identify(meal),
                images=images,
                views=views,
                maps=maps,
                options=options,
                chosen=chosen,
                library=library,
                regions=regions,
            )

    def _request(self, plan: _Plan, paths: Mapping[str, Path], folder: Path) -> ChildRequest:
        """paths: by slot. folder: for the pictures."""
        files = {slot: str(path) for slot, path in paths.items()}
        depths = {
            view: {
                "depth": files[depth_slot(view)],
                "camera": plan.meal.details.get("depth_camera"),
                "confidence": files.get(confidence_slot(view)),
            }
            for view in PAIR_SLOTS
            if depth_slot(view) in plan.maps
        }
        index = self._settings.food_index
        return ChildRequest(
            task="estimate",
            arguments={
                "photographs": dict(
                    zip(VIEW_SLOTS, (files[slot] for slot in plan.views), strict=False)
                ),
                "depths": depths,
                "options": options_to_json(plan.options),
                "output_dir": str(folder),
                "max_pixels": self._settings.max_photo_pixels,
                "food_index": str(index) if index is not None else None,
            },
            is_costly=plan.job.is_background,
        )

    def _fetch(self, image: MealImage, folder: Path) -> Path:
        if image.erased_at is not None:
            raise JobFailure(PHOTOGRAPH_ERASED)
        path = folder / f"photo-{image.slot}"
        try:
            self._fetcher.fetch(image.blob_key, path)
        except BlobMissingError as error:
            log.error("photograph_missing", blob_key=image.blob_key)  # noqa: TRY400  # no bug, so no traceback
            raise JobFailure(PHOTO_MISSING) from error
        if sha256_of_file(path) != image.stored_sha256:
            log.error("photo_damaged", blob_key=image.blob_key)
            raise JobFailure(PHOTO_DAMAGED)
        return path

    def await_room(self, job_id: uuid.UUID) -> None:
        """Show to the phone that the meal waits again, because its estimate was interrupted."""
        self._show_stage(job_id, AWAITS_ROOM)

    def _note_stage(self, job: Job, stage: str) -> None:
        log.info("estimate_stage", stage=stage)
        if job.purpose == "meal":
            self._show_stage(job.id, stage)

    def _show_stage(self, job_id: uuid.UUID, stage: str) -> None:
        """Show the progress of the meal's own pair; a failure to do so does not fail the estimate."""
        try:
            with self._database.write() as session:
                job = session.get(Job, job_id)  # None: erased meanwhile
                if job is not None and job.purpose == "meal":
                    meals.set_stage(session, job.meal_id, stage)
        except sqlalchemy.exc.SQLAlchemyError:
            log.warning("stage_not_told", job_id=str(job_id), stage=stage, exc_info=True)


def _scale(
    meal: Meal,
    study: Study,
    details: PairDetails | None,
    rig: StereoRig | None,
    *,
    has_depth: bool,
) -> EstimateOptions:
    """Return options with what the scale may come from: the rig, or marker and poses of the pair."""
    if rig is not None:
        return EstimateOptions(None, rig=rig)
    marker = meal.details["marker"] or study.marker
    poses = details.get("poses") if details is not None else None
    if marker is None and poses is None and not has_depth:
        raise JobFailure(SCALE_MISSING)
    return replace(
        scale_by(marker),
        poses=poses_from_mapping(poses) if poses is not None else None,
    )


def _answer_of(plan: _Plan, done: ChildResult) -> RunAnswer:
    """Return the child's answer, or that of a meal which cannot be measured here.

    Raises BrokenOff (it may succeed later), OSError (of the child; faults.py knows which pass).
    """
    if done.failure is None:
        answer = RunAnswer.model_validate(done.result)
        _note_times(answer)
        return answer
    log.error(
        "estimate_ended_badly",
        meal_id=str(plan.meal.id),
        outcome=done.outcome,
        message=done.message,
    )
    if done.errno is not None:  # such as a full disk
        raise OSError(done.errno, done.message)
    if done.is_passing:
        raise BrokenOff(done.failure)
    ended = MealEstimate(plan.options.method, PIPELINE_VERSION, stages={}, failure=done.failure)
    answer = answer_of(ended, plan.options)
    answer.artefacts = []  # set, so that it is written: a worker of the previous version reads it
    return answer


def _note_times(answer: RunAnswer) -> None:
    """Record the durations of the pipeline's steps in metrics and log."""
    for stage, seconds in answer.stages.items():
        instruments.STAGES.labels(stage if stage in STAGES else "other").observe(seconds)
    instruments.ESTIMATE_SECONDS.observe(answer.seconds)
    log.info("estimate_computed", seconds=round(answer.seconds, 2))
