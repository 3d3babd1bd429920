"""A phone's meal comes in: whole in one request or part by part, any part again, until it is complete and queued.

Photographs are sealed in the blob store first; then meal, photographs and job are written in one transaction. What is
acknowledged is on disk; what is sent again is recognised by its SHA-256. A request that fails after sealing leaves its
blob: another request of the same meal may have just sealed the same key, so deleting it here could lose a photograph.
"""

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import structlog
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren
from app.core.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from app.core.logs import tell
from app.core.settings import Settings
from app.db.session import Database
from app.estimates.check_hints import require_known_foods, require_within
from app.http.upload import ReceivedFile
from app.jobs.queue import JobQueue
from app.meals import queries as meals
from app.meals.announce import announce_meal
from app.meals.job_models import Job
from app.meals.meal_time import MealTime
from app.meals.models import IGNORED, SLOTS, UNKNOWN, Meal, MealImage
from app.meals.receive_photo import (
    SealablePhoto,
    image_row,
    prepare_photo,
    require_unspent,
    require_whole,
    seal_photos,
    unspent_keys,
)
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import is_meal_deleted, meal_deleted, meal_id_of
from app.records.read_meal import MealView, view_of_new_meal
from app.storage.blob_store import BlobStore
from app.vessels.meal_vessels import require_known_vessels

log = structlog.get_logger()

COMPARED = ("captured_at", "time_zone", "marker", "camera", "hints", "complete", "app_version")  # equal: the same again


@dataclass(frozen=True, slots=True)
class MealMetadata:
    """What the phone tells beside the photographs, checked.

    complete: whether the hints are all that there is. location: WGS84, degrees. unknown: what no field of ours stands
    for, by its place.
    """

    client_id: uuid.UUID
    time: MealTime
    marker: str | None = None
    camera: Mapping[str, Any] | None = None
    hints: tuple[Mapping[str, Any], ...] = ()
    complete: bool = False
    location: Mapping[str, float] | None = None
    app_version: str | None = None
    unknown: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Submitted:
    """meal_id: ours. is_new: something was kept that was not there before. view: of a meal that is all new."""

    meal_id: uuid.UUID
    is_new: bool
    view: MealView | None = None


class SubmitMeal:
    """The use case; one a process."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        queue: JobQueue,
        settings: Settings,
        box: SecretBox,
        children: ApiChildren,
    ) -> None:
        self._database = database
        self._box = box
        self._children = children
        self._blobs = blobs
        self._queue = queue
        self._settings = settings

    def submit(
        self,
        caller: DeviceCaller,
        client_id: uuid.UUID,
        metadata: MealMetadata | None,
        files: Mapping[str, ReceivedFile],
    ) -> Submitted:
        """Keep what came. metadata None: the meal must be known already.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError (nothing kept), NotFoundError, ConflictError
        (the id holds something else), GoneError (deleted, or its participant has left), StorageFullError.
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        tell(meal_id=str(meal_id))
        with self._database.read() as session:
            study = session.get_one(Study, caller.study_id)
        policy = policy_of(study)
        if metadata is not None and metadata.marker is None and study.marker is None:
            raise InvalidInputError(
                "Neither the metadata nor the study says which marker lies beside the plate: send marker, "
                "such as plain:9x7:11.",
                code="marker_missing",
            )
        photos = {
            slot: prepare_photo(
                slot,
                file,
                max_pixels=self._settings.max_photo_pixels,
                policy=policy,
            )
            for slot, file in files.items()
        }
        location = policy.kept(
            metadata.location if metadata is not None else None, (photo.location for photo in photos.values())
        )
        details = _details(metadata, location) if metadata is not None else None
        with self._database.read() as session:  # before sealing, so that a refused request leaves no blob
            stored = self._check(session, study.id, session.get(Meal, meal_id), meal_id, details, photos)
            keys = unspent_keys(
                session, {slot: f"{study.id}/{meal_id}/{slot}/{photo.stored_sha256}" for slot, photo in photos.items()}
            )
        require_whole(self._children, caller, photos, stored)
        seal_photos(self._blobs, photos, keys, stored)
        meal = _Arriving(study, client_id, meal_id, metadata, details, location)
        try:
            try:
                return self._write(caller, meal, photos, keys)
            except IntegrityError:  # the same meal came twice at the same time and the other was first
                return self._write(caller, meal, photos, keys)
        except GoneError:  # erased while this was sealed: nobody will ever need it, unless a row has it from before
            with self._database.write() as session:
                privacy.want_deleted(session, list(keys.values()), datetime.now(UTC))
            raise

    def _check(
        self,
        session: Session,
        study_id: uuid.UUID,
        meal: Meal | None,
        meal_id: uuid.UUID,
        details: Mapping[str, Any] | None,
        photos: Mapping[str, SealablePhoto],
    ) -> dict[str, MealImage]:
        if meal is None:
            if is_meal_deleted(session, self._box, meal_id):
                raise meal_deleted()
            if details is None:
                raise _unknown_meal()
            require_known_vessels(session, study_id, details["hints"])
            require_known_foods(session, details["hints"])
            require_within(details["hints"], photos.get("left"))
            return {}
        if meal.origin == "declared":
            raise ConflictError(
                "The meal of this id was told without photographs. Use a new id for a new meal.", code="meal_id_reused"
            )
        changed = sorted(k for k in COMPARED if details is not None and details.get(k) != meal.details.get(k))
        if changed:
            raise ConflictError(
                "A meal with this id is already here with other metadata. Use a new id for a new meal.",
                code="meal_id_reused",
                fields=changed,
            )
        stored = {image.slot: image for image in meals.images_of(session, meal_id)}
        for slot, photo in photos.items():
            if slot in stored and stored[slot].received_sha256 != photo.received_sha256:
                raise ConflictError(
                    f"A meal with this id already has another {slot} photograph. Use a new id for a new meal.",
                    code="meal_id_reused",
                    slot=slot,
                    stored_sha256=stored[slot].received_sha256,
                )
        return stored

    def _write(
        self,
        caller: DeviceCaller,
        arriving: "_Arriving",
        photos: Mapping[str, SealablePhoto],
        keys: Mapping[str, str],
    ) -> Submitted:
        now, meal_id = datetime.now(UTC), arriving.meal_id
        with self._database.write() as session:
            participant = require_in_study(session, caller.participant_id)
            require_unspent(session, keys.values())
            known = meals.lock_meal(session, meal_id)
            stored = self._check(session, arriving.study.id, known, meal_id, arriving.details, photos)
            meal = known if known is not None else _new_meal(caller, arriving, now)
            images = [
                image_row(meal_id, slot, photo, keys[slot], now) for slot, photo in photos.items() if slot not in stored
            ]
            is_complete = meal.status == "receiving" and set(stored) | set(photos) == set(SLOTS)
            meal.version += len(images) + is_complete
            if is_complete:
                meal.status, meal.submitted_at = "queued", now
            if arriving.location is not None and meal.details.get("location") is None:  # a photograph told it
                meal.details = meal.details | {"location": arriving.location}
            session.add(meal)
            session.flush()  # its row first: all others name it
            session.add_all(images)
            is_new = known is None or bool(images)
            if is_new:
                audit.note(session, caller, "meal.receive", subject=meal.alias, slots=sorted(set(photos) - set(stored)))
            if known is None and arriving.metadata is not None and arriving.metadata.app_version is not None:
                people.note_app_version(session, caller.device_id, arriving.metadata.app_version)
            if is_complete:
                self._queue_estimate(session, meal, now)
        if is_new:
            log.info("meal_kept", meal_id=str(meal_id), slots=sorted(photos), status=meal.status)
        view = view_of_new_meal(meal, participant.code, arriving.study.code, images) if known is None else None
        return Submitted(meal_id, is_new, view)

    def _queue_estimate(self, session: Session, meal: Meal, now: datetime) -> None:
        job = Job(id=uuid.uuid4(), meal_id=meal.id, state="queued", attempts=0, enqueued_at=now)
        self._queue.enqueue(session, job)
        log.info("meal_queued", meal_id=str(meal.id), job_id=str(job.id), purpose=job.purpose)
        announce_meal(session, meal)


@dataclass(frozen=True, slots=True)
class _Arriving:
    """A meal on its way into the database. location: what the study's policy leaves of it.

    metadata and details are None together.
    """

    study: Study
    client_id: uuid.UUID
    meal_id: uuid.UUID
    metadata: MealMetadata | None
    details: dict[str, Any] | None
    location: dict[str, float] | None


def _details(metadata: MealMetadata, location: Mapping[str, float] | None) -> dict[str, Any]:
    """What is kept of the metadata; location: what the study's policy leaves of it."""
    return {
        "captured_at": metadata.time.captured_at.isoformat(),
        "time_zone": metadata.time.time_zone,
        "marker": metadata.marker,
        "camera": dict(metadata.camera) if metadata.camera is not None else None,
        "hints": [dict(hint) for hint in metadata.hints],
        "location": location,
        "app_version": metadata.app_version,
        **({"complete": True} if metadata.complete else {}),  # meals from before there was the word have none
        **aside(metadata.unknown),
    }


def aside(unknown: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of fields that are not known: as JSON's text, which every database can hold whatever it says."""
    return {IGNORED: sorted(unknown), UNKNOWN: json.dumps(unknown)} if unknown else {}


def _new_meal(caller: DeviceCaller, arriving: _Arriving, now: datetime) -> Meal:
    metadata, study = arriving.metadata, arriving.study
    if metadata is None or arriving.details is None:
        raise _unknown_meal()
    return Meal(
        id=arriving.meal_id,
        client_id=arriving.client_id,
        study_id=caller.study_id,
        participant_id=caller.participant_id,
        device_id=caller.device_id,
        captured_at=metadata.time.captured_at.astimezone(UTC),  # as the database tells it
        utc_offset_minutes=metadata.time.utc_offset_minutes,
        time_zone=metadata.time.time_zone,
        local_date=metadata.time.local_date(study.day_starts_minutes),  # computed once and never again
        details=arriving.details,
        status="receiving",
        after_due_at=after_due_at(study, metadata.time.captured_at),
        version=1,
        received_at=now,
    )


def _unknown_meal() -> NotFoundError:
    return NotFoundError("There is no such meal yet: PUT /v1/meals/{id} with its metadata first.")


def after_due_at(study: Study, captured_at: datetime) -> datetime | None:
    """Until when a meal's records are provisional, since an after-meal pair may come; None: the study expects none."""
    if not study.expects_after_pair:
        return None
    return captured_at.astimezone(UTC) + timedelta(minutes=study.after_window_minutes)
