"""Receive a phone's meal, whole or part by part, and queue its estimate once all of its photographs are here.

Photographs are sealed in the blob store first; then meal, photographs and job are written in one
transaction. What is acknowledged is on disk; what is sent again is recognised by its SHA-256. A
request that fails after sealing leaves its blob: another request of the same meal may have just
sealed the same key, so deleting it here could lose a photograph.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import structlog
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.core.logs import bind_log_context
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.announce import announce_meal
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.receive_photo import (
    PhotoIntake,
    SealablePhoto,
    image_rows,
    require_unspent,
    unspent_keys,
)
from app.meals.upload.meal_draft import (
    MealDraft,
    other_meal,
    require_announced,
    require_same,
    require_scale,
    require_valid_hints,
)
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import meal_id_of, require_not_deleted
from app.photos.slots import image_name
from app.records.read_meal import MealView
from app.vision.photograph.depth_camera import depth_camera_from_mapping

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Submitted:
    """is_new: something was added. view: of a meal that this request created."""

    is_new: bool
    view: MealView | None = None


@dataclass(frozen=True, slots=True)
class _Upload:
    """A request's meal.

    draft: None if the request has photographs alone
    location: as the study's policy allows
    """

    study: Study
    meal_id: uuid.UUID
    draft: MealDraft | None
    location: dict[str, float] | None


class SubmitMeal:
    """The use case; one per process."""

    def __init__(
        self, database: Database, photo_intake: PhotoIntake, queue: JobQueue, box: SecretBox
    ) -> None:
        self._database = database
        self._photo_intake = photo_intake
        self._queue = queue
        self._box = box

    def submit(
        self,
        caller: DeviceCaller,
        client_id: uuid.UUID,
        draft: MealDraft | None,
        files: Mapping[str, ReceivedFile],
    ) -> Submitted:
        """Keep the metadata and the photographs, by slot. draft None: the meal must exist.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError, PhotographError (nothing is
        kept), NotFoundError, ConflictError (the id has other content), GoneError (deleted, or its
        participant has left), StorageFullError, UnavailableError.
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        bind_log_context(meal_id=str(meal_id))
        with self._database.read() as session:
            study = session.get_one(Study, caller.study_id)
            meal = session.get(Meal, meal_id)
            stored = meals.images_by_slot(session, meal_id)
            if draft is not None and meal is None:  # the rig of a stored meal may be gone since
                require_scale(session, caller.device_id, study, draft.details)
        policy = policy_of(study)
        sent = draft.details if draft is not None else None
        kept = meal.details if meal is not None else sent
        depth_camera = kept.get("depth_camera") if kept is not None else None
        if depth_camera is not None:
            depth_camera_from_mapping(depth_camera)  # raises if it is impossible
        photos = self._photo_intake.prepare(caller, files, policy, stored, depth_camera)
        tagged = (photo.location for photo in photos.values())
        location = policy.apply(sent["location"] if sent is not None else None, tagged)
        upload = _Upload(study, meal_id, draft, location)
        with self._database.read() as session:  # first, so that a refused request leaves no blob
            stored = self._check(session, session.get(Meal, meal_id), upload, photos)
            keys = unspent_keys(session, _blob_keys(upload, photos))
        with self._photo_intake.sealed(photos, keys, stored):
            try:
                return self._write(caller, upload, photos, keys)
            except IntegrityError:  # an identical upload was committed first
                return self._write(caller, upload, photos, keys)

    def _check(
        self,
        session: Session,
        meal: Meal | None,
        upload: _Upload,
        photos: Mapping[str, SealablePhoto],
    ) -> dict[str, MealImage]:
        """Return the meal's stored photographs. Raises if the upload cannot be added to them."""
        if meal is None:
            require_not_deleted(session, self._box, upload.meal_id)
            details = _require_draft(upload).details
            require_announced(details, photos)
            require_valid_hints(session, upload.study.id, details["hints"], photos.get("left"))
            return {}
        if upload.draft is not None:
            require_same(upload.draft, meal)
        elif meal.origin == "declared":
            raise other_meal()
        require_announced(meal.details, photos)
        stored = meals.images_by_slot(session, upload.meal_id)
        for slot, photo in photos.items():
            if slot in stored and stored[slot].received_sha256 != photo.received_sha256:
                raise ConflictError(
                    f"A meal with this id already has another {image_name(slot)}. Use a new id for "
                    "a new meal.",
                    code="meal_id_reused",
                    slot=slot,
                    stored_sha256=stored[slot].received_sha256,
                )
        return stored

    def _write(
        self,
        caller: DeviceCaller,
        upload: _Upload,
        photos: Mapping[str, SealablePhoto],
        keys: Mapping[str, str],
    ) -> Submitted:
        with self._database.write() as session:
            participant = require_in_study(session, caller.participant_id)
            require_unspent(session, keys.values())
            existing = meals.lock_meal(session, upload.meal_id)
            stored = self._check(session, existing, upload, photos)
            meal = existing or _new_meal(session, caller, upload)
            images = image_rows(meal.id, photos, keys, but=stored)
            arrived = stored.keys() | photos.keys()
            is_complete = meal.status == "receiving" and arrived >= set(meal.announced_slots)
            meal.version += len(images) + is_complete
            if is_complete:
                meal.status, meal.submitted_at = "queued", datetime.now(UTC)
            if upload.location is not None and meal.details.get("location") is None:
                meal.details = meal.details | {
                    "location": upload.location
                }  # of a photograph's tags
            session.add(meal)
            session.flush()  # the meal's row first: all others refer to it
            session.add_all(images)
            is_new = existing is None or bool(images)
            if is_new:
                slots = sorted(photos.keys() - stored.keys())
                audit.note(session, caller, "meal.receive", subject=meal.alias, slots=slots)
            if is_complete:
                job = self._queue.enqueue_pair(session, meal, "meal")
                log.info(
                    "meal_queued", meal_id=str(meal.id), job_id=str(job.id), purpose=job.purpose
                )
                announce_meal(session, meal)
        if is_new:
            log.info("meal_kept", meal_id=str(meal.id), slots=sorted(photos), status=meal.status)
        if existing is not None:
            return Submitted(is_new)
        in_order = tuple(sorted(images, key=lambda image: image.slot))
        return Submitted(is_new, MealView(meal, participant.code, upload.study.code, in_order))


def _require_draft(upload: _Upload) -> MealDraft:
    if upload.draft is None:
        raise NotFoundError(
            "There is no such meal yet: PUT /v1/meals/{id} with its metadata first."
        )
    return upload.draft


def _new_meal(session: Session, caller: DeviceCaller, upload: _Upload) -> Meal:
    draft = _require_draft(upload)
    if draft.details["app_version"] is not None:
        people.note_app_version(session, caller.device_id, draft.details["app_version"])
    return draft.row(caller, upload.study, upload.meal_id, upload.location)


def _blob_keys(upload: _Upload, photos: Mapping[str, SealablePhoto]) -> dict[str, str]:
    folder = f"{upload.study.id}/{upload.meal_id}"
    return {slot: f"{folder}/{slot}/{photo.stored_sha256}" for slot, photo in photos.items()}
