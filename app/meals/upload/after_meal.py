"""Receive the after-meal pair, part by part, until its metadata and both photographs are here.

The rules are those of the meal's own pair (submit_meal.py): photographs are sealed first, then
written in one transaction; the same bytes again change nothing, other bytes are refused. Two
differences: metadata may be replaced as long as no photograph is stored, since the phone may have
lost those that it announced; a pair that failed may be replaced by another, since the meal cannot
be eaten again; its photographs are then erased. The meal's own status never changes here.

A pair is waited for until its window ends. Then the meal's records are final, unless a pair arrives
later; a chore of every worker (jobs/chores.py) ends windows. Concurrent runs do no harm: a meal is
locked and checked again.
"""

import uuid
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from pydantic import JsonValue
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.core.logs import bind_log_context
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal, MealImage, PairDetails
from app.meals.stored.receive_photo import (
    PhotoIntake,
    SealablePhoto,
    image_rows,
    require_unspent,
    unspent_keys,
)
from app.meals.upload.meal_draft import changed_fields, draft_after, require_valid_hints
from app.meals.upload.schemas import AfterMetadataIn
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.tombstones import meal_id_of, require_not_deleted
from app.photos.slots import AFTER_SLOTS
from app.records.project_records import project_meal

# statuses of a pair that is not queued yet
ARRIVING = frozenset({None, "receiving", "nothing_left"})
BATCH = 100


@dataclass(frozen=True, slots=True)
class _Upload:
    """A request's part of a pair: its metadata, or photographs by slot."""

    meal_id: uuid.UUID
    details: PairDetails | None
    photos: Mapping[str, SealablePhoto]


@dataclass(frozen=True, slots=True)
class _StoredPair:
    """The stored part of a pair.

    attempt: how many pairs of this meal had a job before
    changed: fields of the upload's metadata that differ from the stored ones
    is_replaced: it failed, and the upload begins another
    """

    images: Mapping[str, MealImage]
    attempt: int
    changed: Collection[str]
    is_replaced: bool

    @property
    def slots(self) -> set[str]:
        """Slots whose photograph stays."""
        return set() if self.is_replaced else set(self.images)


class SubmitAfterPair:
    """The use case; one per process."""

    def __init__(
        self, database: Database, photo_intake: PhotoIntake, queue: JobQueue, box: SecretBox
    ) -> None:
        self._database = database
        self._photo_intake = photo_intake
        self._queue = queue
        self._box = box

    def announce(
        self,
        caller: DeviceCaller,
        client_id: uuid.UUID,
        metadata: AfterMetadataIn,
        unknown: Mapping[str, JsonValue],
    ) -> bool:
        """Keep the pair's metadata. Returns whether something was added.

        Raises NotFoundError, GoneError, InvalidInputError (before the meal), ConflictError (other
        metadata are here with a photograph; the pair is queued already; the meal has no
        photographs).
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        bind_log_context(meal_id=str(meal_id))
        with self._database.read() as session:
            meal = self._require_meal(session, session.get(Meal, meal_id), meal_id)
        details = draft_after(metadata, meal.time_zone, unknown)
        return self._keep(caller, _Upload(meal_id, details, {}))

    def receive(
        self, caller: DeviceCaller, client_id: uuid.UUID, files: Mapping[str, ReceivedFile]
    ) -> bool:
        """Keep photographs by slot, and queue the pair once both are here.

        Returns whether something was added. Raises InvalidInputError, TooLargeError,
        UnsupportedMediaError, PhotographError (nothing is kept), NotFoundError, GoneError,
        ConflictError (another photograph is here; the meal has none), StorageFullError,
        UnavailableError.
        """
        meal_id = meal_id_of(caller.participant_id, client_id)
        bind_log_context(meal_id=str(meal_id))
        with self._database.read() as session:
            policy = policy_of(session.get_one(Study, caller.study_id))
            meal = session.get(Meal, meal_id)
            may_be_replaced = meal is None or meal.after_status == "failed"
            stored = {} if may_be_replaced else meals.images_by_slot(session, meal_id)
        photos = self._photo_intake.prepare(caller, files, policy, stored)
        return self._keep(caller, _Upload(meal_id, None, photos))

    def _keep(self, caller: DeviceCaller, upload: _Upload) -> bool:
        meal_id, photos = upload.meal_id, upload.photos
        with self._database.read() as session:  # first, so that a refused request leaves no blob
            stored = self._check(session, session.get(Meal, meal_id), upload)
            # a later attempt has its own keys: the same bytes may be sent again while those of the
            # failed one are deleted
            again = f"{stored.attempt}/" if stored.attempt else ""
            named_keys = {
                slot: f"{caller.study_id}/{meal_id}/{slot}/{again}{photo.stored_sha256}"
                for slot, photo in photos.items()
            }
            keys = unspent_keys(session, named_keys)
        with self._photo_intake.sealed(photos, keys, stored.slots):
            try:
                return self._write(caller, upload, stored, keys)
            except IntegrityError:  # an identical upload was committed first
                return self._write(caller, upload, stored, keys)

    def _write(
        self,
        caller: DeviceCaller,
        upload: _Upload,
        stored_before: _StoredPair,
        keys: Mapping[str, str],
    ) -> bool:
        """stored_before: when the photographs were sealed."""
        meal_id, photos = upload.meal_id, upload.photos
        with self._database.write() as session:
            require_in_study(session, caller.participant_id)
            require_unspent(session, keys.values())
            meal = self._require_meal(session, meals.lock_meal(session, meal_id), meal_id)
            stored = self._check(session, meal, upload)
            added = photos.keys() - stored.slots
            is_other_attempt = stored.attempt != stored_before.attempt
            if photos and (is_other_attempt or added & stored_before.slots):
                raise ConflictError(
                    "Another pair came in at the same time: GET the meal, then send again."
                )
            if stored.is_replaced:
                _erase_failed_pair(session, meal, stored.images.values())
            if stored.changed:
                meal.after_details = upload.details
            session.add_all(image_rows(meal_id, photos, keys, but=stored.slots))
            if not (stored.is_replaced or stored.changed or added):
                return False
            meal.after_status = meal.after_status or "receiving"
            if added and stored.slots | added == set(AFTER_SLOTS):
                meal.after_status = "queued"
                self._queue.enqueue_pair(session, meal, "after")
            if stored.is_replaced:  # its records no longer follow from the pair that failed
                project_meal(session, meal)
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
                "This meal was entered without photographs: there is nothing to compare an "
                "after-meal pair with.",
                code="meal_without_photographs",
            )
        photos, details = upload.photos, upload.details
        stored = meals.images_by_slot(session, meal.id)
        images = {slot: stored[slot] for slot in AFTER_SLOTS if slot in stored}
        changed = changed_fields(details, meal.after_details) if details is not None else []
        if details is not None:
            if datetime.fromisoformat(details["captured_at"]) < meal.captured_at:
                raise InvalidInputError(
                    "The after-meal pair was taken before the meal.", code="after_pair_before_meal"
                )
            if changed:
                photo = images.get("after_left")
                require_valid_hints(session, meal.study_id, details["hints"], photo)
        others = [
            slot
            for slot, photo in photos.items()
            if slot in images and images[slot].received_sha256 != photo.received_sha256
        ]
        attempt, _ = jobs.count_jobs(session, meal.id, "after")
        if meal.after_status == "failed":
            return _StoredPair(images, attempt, changed, is_replaced=bool(others or changed))
        if others:
            raise ConflictError(
                f"This meal already has another {others[0]} photograph.",
                code="after_pair_differs",
                slot=others[0],
                stored_sha256=images[others[0]].received_sha256,
            )
        if changed and meal.after_details is not None and images:
            raise ConflictError(
                "This after-meal pair is already here with other metadata.",
                code="after_pair_differs",
                fields=changed,
            )
        if changed and meal.after_status not in ARRIVING:
            raise ConflictError(
                "The after-meal pair is queued already: send its metadata before its second "
                "photograph.",
                code="after_pair_queued",
            )
        attempt -= meal.after_status not in ARRIVING  # the stored pair has its job already
        return _StoredPair(images, attempt, changed, is_replaced=False)


def _erase_failed_pair(session: Session, meal: Meal, images: Collection[MealImage]) -> None:
    """Make room for another pair: erase the photographs of the failed one; its run stays."""
    privacy.schedule_deletion(session, [image.blob_key for image in images], datetime.now(UTC))
    for image in images:
        session.delete(image)
    session.flush()
    meal.after_details = None
    meal.pair("after").set_status("receiving")
    meal.pair("after").set_failure(None)


def end_due_windows(database: Database) -> int:
    """End at most BATCH windows that are over, each in its own transaction.

    Returns their number. A pair that is queued or being measured ends its window itself.
    """
    now, ended = datetime.now(UTC), 0
    with database.read() as session:
        due = meals.after_windows_over(session, now, BATCH)
    for meal_id in due:
        with database.write() as session:
            meal = meals.lock_meal(session, meal_id)
            if meal is not None and _is_over(meal, now):
                meal.after_due_at = None
                project_meal(session, meal)
                ended += 1
    return ended


def _is_over(meal: Meal, now: datetime) -> bool:
    has_ended = meal.after_due_at is not None and meal.after_due_at <= now
    return has_ended and meal.after_status not in meals.WAITING
