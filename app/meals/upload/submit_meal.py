"""Receive a phone's meal, whole or part by part, and queue its estimate once all of its photographs are here.

Photographs are sealed in the blob store first; then meal, photographs and job are written in one
transaction. What is acknowledged is on disk; what is sent again is recognised by its SHA-256. A
request that fails after sealing leaves its blob: another request of the same meal may have just
sealed the same key, so deleting it here could lose a photograph.
"""

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import structlog
from pydantic import JsonValue
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.core.logs import bind_log_context
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.jobs.queue import JobQueue
from app.meals.estimate.camera_choice import stored_rigs
from app.meals.estimate.check_hints import require_valid_hints
from app.meals.stored import queries as meals
from app.meals.stored.announce import announce_meal
from app.meals.stored.meal_time import MealTime
from app.meals.stored.models import (
    DEFAULT_VIEWS,
    AsideDetails,
    DepthCameraDetails,
    HintDetails,
    Meal,
    MealDetails,
    MealImage,
    PosesDetails,
    announced_slots,
)
from app.meals.stored.receive_photo import (
    PhotoIntake,
    SealablePhoto,
    image_row,
    require_unspent,
    unspent_keys,
)
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.calibration_models import CameraDetails, RigDetails
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import meal_id_of, require_not_deleted
from app.photos.slots import DEPTH_SLOTS, VOICE_NOTE, image_name
from app.records.read_meal import MealView
from app.vision.depth_camera import depth_camera_from_mapping, size_mismatch

log = structlog.get_logger()

COMPARED = (  # equal in a repetition
    "captured_at",
    "time_zone",
    "marker",
    "camera",
    "rig",
    "poses",
    "hints",
    "complete",
    "views",
    "depth_camera",
    "depth_maps",
    "app_version",
)  # equal: a repetition


@dataclass(frozen=True, slots=True)
class MealMetadata:
    """The checked metadata of a meal.

    location: WGS84, degrees. views: number of photographs. depth_maps: their slots. unknown: fields
    that no model has, by their place. wanted_outcome: how the estimate is to end, by a
    MetadataHook.
    """

    client_id: uuid.UUID
    time: MealTime
    marker: str | None = None
    camera: CameraDetails | None = None
    rig: RigDetails | None = None
    poses: PosesDetails | None = None
    hints: tuple[HintDetails, ...] = ()
    complete: bool = False
    location: Mapping[str, float] | None = None
    app_version: str | None = None
    views: int = DEFAULT_VIEWS
    depth_camera: DepthCameraDetails | None = None
    depth_maps: tuple[str, ...] = ()
    unknown: Mapping[str, JsonValue] = field(default_factory=dict)
    wanted_outcome: str | None = None


@dataclass(frozen=True, slots=True)
class Submitted:
    """is_new: something was added. view: of a meal that this request created."""

    is_new: bool
    view: MealView | None = None


@dataclass(frozen=True, slots=True)
class _Upload:
    """A request's meal. location: as the study's policy allows. metadata and details are None together."""

    study: Study
    client_id: uuid.UUID
    meal_id: uuid.UUID
    metadata: MealMetadata | None
    details: MealDetails | None
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
        metadata: MealMetadata | None,
        files: Mapping[str, ReceivedFile],
    ) -> Submitted:
        """Keep the metadata and the photographs, by slot. metadata None: the meal must exist.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError, PhotographError (nothing is
        kept), NotFoundError, ConflictError (the id has other content), GoneError (deleted, or its
        participant has left), StorageFullError, UnavailableError.
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        bind_log_context(meal_id=str(meal_id))
        with self._database.read() as session:
            study = session.get_one(Study, caller.study_id)
            meal = session.get(Meal, meal_id)
            stored = {image.slot: image for image in meals.images_of(session, meal_id)}
            is_new = metadata is not None and meal is None  # a meal's rig may be gone since
            if metadata is not None and is_new and not _has_scale(session, caller, study, metadata):
                raise InvalidInputError(
                    "Neither the metadata nor the study says which marker lies beside the plate: send marker, "
                    "such as plain:9x7:11, or a stereo rig or the cameras' poses.",
                    code="marker_missing",
                )
        policy = policy_of(study)
        depth_camera = _depth_camera(metadata, meal)
        photos = self._photo_intake.prepare(caller, files, policy, stored, depth_camera)
        location = policy.apply(
            metadata.location if metadata is not None else None,
            (photo.location for photo in photos.values()),
        )
        details = _details(metadata, location) if metadata is not None else None
        upload = _Upload(study, client_id, meal_id, metadata, details, location)
        with (
            self._database.read() as session
        ):  # before sealing, so that a refused request leaves no blob
            meal = session.get(Meal, meal_id)
            stored = self._check(session, meal, upload, photos)
            keys = unspent_keys(
                session,
                {
                    slot: f"{study.id}/{meal_id}/{slot}/{photo.stored_sha256}"
                    for slot, photo in photos.items()
                },
            )
        return self._photo_intake.seal_and_write(
            photos, keys, stored, lambda: self._write(caller, upload, photos, keys)
        )

    def _check(
        self,
        session: Session,
        meal: Meal | None,
        upload: _Upload,
        photos: Mapping[str, SealablePhoto],
    ) -> dict[str, MealImage]:
        """Return the meal's stored photographs by slot. Raises if the upload cannot be added to them."""
        details = upload.details
        if meal is None:
            require_not_deleted(session, self._box, upload.meal_id)
            if details is None:
                raise _unknown_meal()
            _require_announced(details, photos)
            if details["hints"]:
                require_valid_hints(session, upload.study.id, details["hints"], photos.get("left"))
            return {}
        if meal.origin == "declared":
            raise ConflictError(
                "The meal of this id was entered without photographs. Use a new id for a new meal.",
                code="meal_id_reused",
            )
        changed = sorted(
            k for k in COMPARED if details is not None and details.get(k) != meal.details.get(k)
        )
        if changed:
            raise ConflictError(
                "A meal with this id is already here with other metadata. Use a new id for a new meal.",
                code="meal_id_reused",
                fields=changed,
            )
        _require_announced(meal.details, photos)
        stored = {image.slot: image for image in meals.images_of(session, upload.meal_id)}
        for slot, photo in photos.items():
            if slot in stored and stored[slot].received_sha256 != photo.received_sha256:
                raise ConflictError(
                    f"A meal with this id already has another {image_name(slot)}. Use a new id for a new meal.",
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
        now, meal_id = datetime.now(UTC), upload.meal_id
        with self._database.write() as session:
            participant = require_in_study(session, caller.participant_id)
            require_unspent(session, keys.values())
            existing = meals.lock_meal(session, meal_id)
            stored = self._check(session, existing, upload, photos)
            meal = existing if existing is not None else _new_meal(caller, upload, now)
            images = [
                image_row(meal_id, slot, photo, keys[slot], now)
                for slot, photo in photos.items()
                if slot not in stored
            ]
            is_complete = meal.status == "receiving" and set(meal.announced_slots) <= set(
                stored
            ) | set(photos)
            meal.version += len(images) + is_complete
            if is_complete:
                meal.status, meal.submitted_at = "queued", now
            if (
                upload.location is not None and meal.details.get("location") is None
            ):  # from a photograph's tags
                meal.details = meal.details | {"location": upload.location}
            session.add(meal)
            session.flush()  # the meal's row first: all others refer to it
            session.add_all(images)
            is_new = existing is None or bool(images)
            if is_new:
                audit.note(
                    session,
                    caller,
                    "meal.receive",
                    subject=meal.alias,
                    slots=sorted(set(photos) - set(stored)),
                )
            if (
                existing is None
                and upload.metadata is not None
                and upload.metadata.app_version is not None
            ):
                people.note_app_version(session, caller.device_id, upload.metadata.app_version)
            if is_complete:
                job = self._queue.enqueue_pair(session, meal, "meal")
                log.info(
                    "meal_queued", meal_id=str(meal_id), job_id=str(job.id), purpose=job.purpose
                )
                announce_meal(session, meal)
        if is_new:
            log.info("meal_kept", meal_id=str(meal_id), slots=sorted(photos), status=meal.status)
        if existing is not None:
            return Submitted(is_new)
        arrived = tuple(sorted(images, key=lambda image: image.slot))
        return Submitted(is_new, MealView(meal, participant.code, upload.study.code, arrived))


def _has_scale(
    session: Session, caller: DeviceCaller, study: Study, metadata: MealMetadata
) -> bool:
    """Return whether a marker, a rig, poses or a depth map of the left photograph give the scale."""
    if (
        "left_depth" in metadata.depth_maps
        or metadata.marker is not None
        or metadata.rig is not None
        or study.marker is not None
    ):
        return True
    if metadata.views != DEFAULT_VIEWS:
        return False
    return metadata.poses is not None or any(stored_rigs(session, caller.device_id, study.id))


def _depth_camera(metadata: MealMetadata | None, meal: Meal | None) -> DepthCameraDetails | None:
    """Return that of the maps: the stored meal's, of a new one its metadata's. Raises InvalidInputError."""
    if meal is not None:
        return meal.details.get("depth_camera")
    if metadata is None or metadata.depth_camera is None:
        return None
    depth_camera_from_mapping(metadata.depth_camera)  # raises if it is impossible
    return metadata.depth_camera


def _details(metadata: MealMetadata, location: dict[str, float] | None) -> MealDetails:
    """Return the metadata as stored. location: as the study's policy allows."""
    details: MealDetails = {
        "captured_at": metadata.time.captured_at.isoformat(),
        "time_zone": metadata.time.time_zone,
        "marker": metadata.marker,
        "camera": metadata.camera,
        "hints": list(metadata.hints),
        "location": location,
        "app_version": metadata.app_version,
    }
    keep_unknown(details, metadata.unknown)
    if metadata.complete:  # absent otherwise: meals that are older than the field have none
        details["complete"] = True
    if metadata.views != DEFAULT_VIEWS:
        details["views"] = metadata.views
    if metadata.rig is not None:
        details["rig"] = metadata.rig
    if metadata.wanted_outcome is not None:
        details["wanted_outcome"] = metadata.wanted_outcome
    if metadata.depth_camera is not None:
        details["depth_camera"], details["depth_maps"] = (
            metadata.depth_camera,
            list(metadata.depth_maps),
        )
    if metadata.poses is not None:
        details["poses"] = metadata.poses
    return details


def keep_unknown(details: AsideDetails, unknown: Mapping[str, JsonValue]) -> None:
    """Add the fields that no model has: their values as JSON text, so that every database can hold any of them."""
    if unknown:
        details["ignored"], details["unknown"] = sorted(unknown), json.dumps(unknown)


def _require_announced(details: MealDetails, photos: Mapping[str, SealablePhoto]) -> None:
    """Raise InvalidInputError if a slot is none that the metadata announced, or a map is not of the depth camera."""
    slots = announced_slots(details)
    surplus = [slot for slot in photos if slot not in slots and slot != VOICE_NOTE]
    if surplus:
        raise InvalidInputError(
            f"The metadata announced {', '.join(slots)} (by views and depth_maps), so there is no "
            f"{', '.join(surplus)}.",
            code="view_not_announced",
            slots=surplus,
        )
    if "depth_camera" not in details:
        return
    camera = depth_camera_from_mapping(details["depth_camera"])
    for slot, photo in photos.items():
        if slot not in DEPTH_SLOTS:
            continue
        mismatch = size_mismatch(photo.width_px, photo.height_px, camera)
        if mismatch is not None:
            raise InvalidInputError(
                f"The {image_name(slot)}: {mismatch.message} {mismatch.advice}",
                code=mismatch.code,
                slot=slot,
            )


def _new_meal(caller: DeviceCaller, upload: _Upload, now: datetime) -> Meal:
    metadata, study = upload.metadata, upload.study
    if metadata is None or upload.details is None:
        raise _unknown_meal()
    captured_at = metadata.time.captured_at.astimezone(UTC)  # as the database returns it
    return Meal(
        id=upload.meal_id,
        client_id=upload.client_id,
        study_id=caller.study_id,
        participant_id=caller.participant_id,
        device_id=caller.device_id,
        captured_at=captured_at,
        utc_offset_minutes=metadata.time.utc_offset_minutes,
        time_zone=metadata.time.time_zone,
        local_date=metadata.time.local_date(
            study.day_starts_minutes
        ),  # computed once and never again
        details=upload.details,
        status="receiving",
        after_due_at=captured_at + timedelta(minutes=study.after_window_minutes)
        if study.expects_after_pair
        else None,
        version=1,
        received_at=now,
    )


def _unknown_meal() -> NotFoundError:
    return NotFoundError("There is no such meal yet: PUT /v1/meals/{id} with its metadata first.")
