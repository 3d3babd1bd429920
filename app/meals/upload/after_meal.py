"""Receive the after-meal pair, part by part, any part again, until its metadata and both photographs are here.

The rules are those of the meal's own pair (submit_meal.py): photographs are sealed first, then
written in one transaction; the same bytes again change nothing, other bytes are refused. Two
differences: metadata may be replaced as long as no photograph is stored, since the phone may have
lost those that it announced; a pair that failed may be replaced by another, since the meal cannot
be eaten again; its photographs are then erased. The meal's own status never changes here.
"""

import uuid
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

from pydantic import JsonValue
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.core.logs import bind_log_context
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.estimate.check_hints import require_valid_hints
from app.meals.stored import queries as meals
from app.meals.stored.meal_time import MealTime
from app.meals.stored.models import (
    AsideDetails,
    HintDetails,
    Meal,
    MealImage,
    PairDetails,
    PosesDetails,
)
from app.meals.stored.receive_photo import (
    PhotoIntake,
    SealablePhoto,
    image_row,
    require_unspent,
    unspent_keys,
)
from app.meals.upload.submit_meal import keep_unknown
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.calibration_models import CameraDetails
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import meal_id_of, require_not_deleted
from app.photos.slots import AFTER_SLOTS
from app.records.project_records import project_meal

NOT_COMPARED = AsideDetails.__optional_keys__
ARRIVING = frozenset(
    {None, "receiving", "nothing_left"}
)  # statuses of a pair that is not queued yet


@dataclass(frozen=True, slots=True)
class AfterMetadata:
    """The checked metadata of an after-meal pair. hints: in after_left's pixels. complete: the hints are all of it."""

    time: MealTime
    camera: CameraDetails | None = None
    poses: PosesDetails | None = None
    hints: tuple[HintDetails, ...] = ()
    complete: bool = False
    unknown: Mapping[str, JsonValue] = field(default_factory=dict)

    def details(self) -> PairDetails:
        """Return the metadata as stored and compared."""
        details: PairDetails = {
            "captured_at": self.time.captured_at.isoformat(),
            "time_zone": self.time.time_zone,
            "camera": self.camera,
            "hints": list(self.hints),
        }
        keep_unknown(details, self.unknown)
        if self.complete:
            details["complete"] = True
        if self.poses is not None:
            details["poses"] = self.poses
        return details


@dataclass(frozen=True, slots=True)
class _Upload:
    """A request's part of a pair. details and captured_at: None without metadata. photos: by slot."""

    meal_id: uuid.UUID
    details: PairDetails | None = None
    captured_at: datetime | None = None
    photos: Mapping[str, SealablePhoto] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _StoredPair:
    """The stored part of a pair. attempt: how many pairs of this meal had a job before.

    is_replaced: it failed, and the upload begins another.
    """

    images: Mapping[str, MealImage]
    attempt: int
    is_replaced: bool

    @property
    def slots(self) -> set[str]:
        """Slots whose photograph stays."""
        return set() if self.is_replaced else set(self.images)


@dataclass(frozen=True, slots=True)
class _Sealed:
    """Photographs in the store before any row names them. slots: those that this request sealed."""

    attempt: int
    keys: Mapping[str, str]
    slots: frozenset[str]


class SubmitAfterPair:
    """The use case; one per process."""

    def __init__(
        self, database: Database, photo_intake: PhotoIntake, queue: JobQueue, box: SecretBox
    ) -> None:
        self._database = database
        self._photo_intake = photo_intake
        self._queue = queue
        self._box = box

    def meal_time_zone(self, caller: DeviceCaller, client_id: uuid.UUID) -> str:
        """Return the meal's time zone, the default of its after-meal pair's. Raises NotFoundError, GoneError."""
        meal_id = meal_id_of(caller.participant_id, client_id)
        bind_log_context(meal_id=str(meal_id))
        with self._database.read() as session:
            return self._require_meal(session, session.get(Meal, meal_id), meal_id).time_zone

    def announce(self, caller: DeviceCaller, client_id: uuid.UUID, metadata: AfterMetadata) -> bool:
        """Keep the pair's metadata, before its second photograph. Returns whether something was added.

        Raises NotFoundError, GoneError, InvalidInputError (before the meal), ConflictError (other
        metadata are here with a photograph; the pair is queued already; the meal has no
        photographs).
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        return self._keep(caller, _Upload(meal_id, metadata.details(), metadata.time.captured_at))

    def receive(
        self, caller: DeviceCaller, client_id: uuid.UUID, files: Mapping[str, ReceivedFile]
    ) -> bool:
        """Keep photographs by slot, and queue the pair once both are here. Returns whether something was added.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError, PhotographError (nothing is
        kept), NotFoundError, GoneError, ConflictError (another photograph is here; the meal has
        none), StorageFullError, UnavailableError.
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        with self._database.read() as session:
            policy = policy_of(session.get_one(Study, caller.study_id))
            meal = session.get(Meal, meal_id)
            may_be_replaced = meal is None or meal.after_status == "failed"
            images = [] if may_be_replaced else meals.images_of(session, meal_id)
        photos = self._photo_intake.prepare(
            caller, files, policy, {image.slot: image for image in images}
        )
        return self._keep(caller, _Upload(meal_id, photos=photos))

    def _keep(self, caller: DeviceCaller, upload: _Upload) -> bool:
        meal_id, photos = upload.meal_id, upload.photos
        bind_log_context(meal_id=str(meal_id))
        with (
            self._database.read() as session
        ):  # before sealing, so that a refused request leaves no blob
            stored = self._check(session, session.get(Meal, meal_id), upload)
            keys = unspent_keys(
                session,
                {
                    slot: _blob_key(caller.study_id, meal_id, slot, stored.attempt, p)
                    for slot, p in photos.items()
                },
            )
        sealed = _Sealed(stored.attempt, keys, frozenset(set(photos) - stored.slots))
        return self._photo_intake.seal_and_write(
            photos, keys, stored.slots, lambda: self._write(caller, upload, sealed)
        )

    def _write(self, caller: DeviceCaller, upload: _Upload, sealed: _Sealed) -> bool:
        now, meal_id = datetime.now(UTC), upload.meal_id
        with self._database.write() as session:
            require_in_study(session, caller.participant_id)
            require_unspent(session, sealed.keys.values())
            meal = self._require_meal(session, meals.lock_meal(session, meal_id), meal_id)
            stored = self._check(session, meal, upload)
            added = {
                slot: photo for slot, photo in upload.photos.items() if slot not in stored.slots
            }
            if upload.photos and (
                stored.attempt != sealed.attempt or not added.keys() <= sealed.slots
            ):
                raise ConflictError(
                    "Another pair came in at the same time: GET the meal, then send again."
                )
            if stored.is_replaced:
                _erase_failed_pair(session, meal, stored.images.values(), now)
            has_new_details = bool(_changed_fields(upload.details, meal.after_details))
            if has_new_details:
                meal.after_details = upload.details
            session.add_all(
                image_row(meal_id, slot, photo, sealed.keys[slot], now)
                for slot, photo in added.items()
            )
            if not (stored.is_replaced or has_new_details or added):
                return False
            meal.after_status = meal.after_status or "receiving"
            if added and stored.slots | set(added) == set(AFTER_SLOTS):
                meal.after_status = "queued"
                self._queue.enqueue_pair(session, meal, "after")
            if stored.is_replaced:
                project_meal(
                    session, meal
                )  # its records no longer follow from the pair that failed
            meal.version += 1
            audit.note(session, caller, "meal.receive", subject=meal.alias, slots=sorted(added))
        return True

    def _require_meal(self, session: Session, meal: Meal | None, meal_id: uuid.UUID) -> Meal:
        if meal is None:
            require_not_deleted(session, self._box, meal_id)
            raise NotFoundError("There is no such meal: send the meal before its after-meal pair.")
        return meal

    def _check(self, session: Session, meal: Meal | None, upload: _Upload) -> _StoredPair:
        """Return the stored part of the pair. Raises if the upload cannot be added to it."""
        meal = self._require_meal(session, meal, upload.meal_id)
        if meal.origin != "photographed":
            raise ConflictError(
                "This meal was entered without photographs: there is nothing to compare an after-meal pair with.",
                code="meal_without_photographs",
            )
        if upload.captured_at is not None and upload.captured_at < meal.captured_at:
            raise InvalidInputError(
                "The after-meal pair was taken before the meal.", code="after_pair_before_meal"
            )
        photos, details = upload.photos, upload.details
        images = {
            image.slot: image
            for image in meals.images_of(session, meal.id)
            if image.slot in AFTER_SLOTS
        }
        other = [
            s
            for s, p in photos.items()
            if s in images and images[s].received_sha256 != p.received_sha256
        ]
        changed = _changed_fields(details, meal.after_details)
        if changed and details is not None and details["hints"]:
            photo = photos.get("after_left") or images.get("after_left")
            require_valid_hints(session, meal.study_id, details["hints"], photo)
        attempt, _ = jobs.count_jobs(session, meal.id, "after")
        if meal.after_status == "failed":
            return _StoredPair(images, attempt, is_replaced=bool(other or changed))
        if other:
            raise ConflictError(
                f"This meal already has another {other[0]} photograph.",
                code="after_pair_differs",
                slot=other[0],
                stored_sha256=images[other[0]].received_sha256,
            )
        if changed and meal.after_details is not None and images:
            raise ConflictError(
                "This after-meal pair is already here with other metadata.",
                code="after_pair_differs",
                fields=changed,
            )
        if changed and meal.after_status not in ARRIVING:
            raise ConflictError(
                "The after-meal pair is queued already: send its metadata before its second photograph.",
                code="after_pair_queued",
            )
        attempt -= meal.after_status not in ARRIVING  # the stored pair has its job already
        return _StoredPair(images, attempt, is_replaced=False)


def _changed_fields(details: PairDetails | None, stored: PairDetails | None) -> list[str]:
    """Return the names of the fields that differ from the stored ones; those kept aside are not compared."""
    if details is None:
        return []
    before: Mapping[str, object] = stored or {}
    return sorted(
        name
        for name, value in details.items()
        if name not in NOT_COMPARED and value != before.get(name)
    )


def _erase_failed_pair(
    session: Session, meal: Meal, images: Collection[MealImage], now: datetime
) -> None:
    """Make room for another pair: the photographs of the failed one are erased, its run stays."""
    privacy.schedule_deletion(session, [image.blob_key for image in images], now)
    for image in images:
        session.delete(image)
    session.flush()
    meal.after_status, meal.after_details = "receiving", None
    meal.after_failure_code = meal.after_failure_message = meal.after_failure_advice = None


def _blob_key(
    study_id: uuid.UUID, meal_id: uuid.UUID, slot: str, attempt: int, photo: SealablePhoto
) -> str:
    """A later attempt has its own keys: the same bytes may be sent again while those of the failed one are deleted."""
    again = f"{attempt}/" if attempt else ""
    return f"{study_id}/{meal_id}/{slot}/{again}{photo.stored_sha256}"


BATCH = 100


class AfterWindows:
    """The chore of one process."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def close_due(self) -> int:
        """End at most BATCH windows that are over, each in its own transaction. Returns their number.

        A pair that is queued or being measured ends its window itself.
        """
        now, closed = datetime.now(UTC), 0
        with self._database.read() as session:
            due = meals.after_windows_over(session, now, BATCH)
        for meal_id in due:
            closed += self._close(meal_id, now)
        return closed

    def _close(self, meal_id: uuid.UUID, now: datetime) -> bool:
        with self._database.write() as session:
            meal = meals.lock_meal(session, meal_id)
            if meal is None or not _is_over(meal, now):
                return False
            meal.after_due_at = None
            project_meal(session, meal)
        return True


def _is_over(meal: Meal, now: datetime) -> bool:
    return (
        meal.after_due_at is not None
        and meal.after_due_at <= now
        and meal.after_status not in meals.WAITING
    )
