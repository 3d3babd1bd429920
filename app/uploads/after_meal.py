"""The after-meal pair comes in: what is told of it and its photographs, part by part, any part again, till both are in.

The rules are those of the meal's own pair (uploads/submit_meal.py): sealed first, then written in one transaction, the
same bytes again are the same, other bytes are refused. One difference: a pair that failed may be sent anew, since the
meal cannot be; its photographs then go. The meal's own status is never moved from here.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren
from app.core.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from app.core.logs import tell
from app.core.settings import Settings
from app.db.session import Database
from app.estimates.check_hints import require_known_foods, require_within
from app.http.upload import ReceivedFile
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals import queries as meals
from app.meals.erased_photographs import erase_failed_pair
from app.meals.job_models import Job
from app.meals.meal_time import MealTime
from app.meals.models import AFTER_SLOTS, ASIDE, Meal, MealImage
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
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.secret_box import SecretBox
from app.people.location_policy import policy_of
from app.people.models import Study
from app.people.participants import has_left
from app.people.tombstones import is_meal_deleted, meal_deleted, meal_id_of
from app.records.project_records import project_meal
from app.storage.blob_store import BlobStore
from app.uploads.submit_meal import Submitted, aside
from app.vessels.meal_vessels import require_known_vessels

ARRIVING = frozenset({None, "receiving", "nothing_left"})  # the pair is not queued yet


@dataclass(frozen=True, slots=True)
class AfterMetadata:
    """What the phone tells of the after-meal pair, checked.

    hints: as the API has them, in after_left's pixels. complete: whether they are all that is left.
    """

    time: MealTime
    camera: Mapping[str, Any] | None = None
    hints: tuple[Mapping[str, Any], ...] = ()
    complete: bool = False
    unknown: Mapping[str, Any] = field(default_factory=dict)

    def details(self) -> dict[str, Any]:
        """As it is kept and compared."""
        return {
            "captured_at": self.time.captured_at.isoformat(),
            "time_zone": self.time.time_zone,
            "camera": dict(self.camera) if self.camera is not None else None,
            "hints": [dict(hint) for hint in self.hints],
            **({"complete": True} if self.complete else {}),
            **aside(self.unknown),
        }


@dataclass(frozen=True, slots=True)
class _Known:
    """What is there already. attempt: how many pairs of this meal were measured or failed before."""

    stored: Mapping[str, MealImage]
    attempt: int
    is_anew: bool


@dataclass(frozen=True, slots=True)
class _Sealed:
    """What is in the store before any row names it. keys: of all photographs; slots: those that were not there yet."""

    attempt: int
    keys: Mapping[str, str]
    slots: frozenset[str]


class SubmitAfterPair:
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

    def zone_of(self, caller: DeviceCaller, client_id: uuid.UUID) -> str:
        """The meal's time zone, which its after-meal pair has unless it tells another. Raises as `announce`."""
        meal_id = meal_id_of(caller.participant_id, client_id)
        tell(meal_id=str(meal_id))
        with self._database.read() as session:
            return self._meal(session.get(Meal, meal_id), session, meal_id).time_zone

    def announce(self, caller: DeviceCaller, client_id: uuid.UUID, told: AfterMetadata) -> Submitted:
        """Keep what the phone tells of the pair, before its second photograph.

        Raises NotFoundError, GoneError, InvalidInputError (before the meal), ConflictError (told otherwise before; the
        pair is queued already; the meal has no photographs).
        """
        return self._keep(caller, client_id, told.details(), {}, told.time.captured_at)

    def receive(self, caller: DeviceCaller, client_id: uuid.UUID, files: Mapping[str, ReceivedFile]) -> Submitted:
        """Keep photographs by slot; with both there, the pair is queued.

        Raises InvalidInputError, TooLargeError, UnsupportedMediaError (nothing kept), NotFoundError, GoneError,
        ConflictError (another photograph is there; the meal has none), StorageFullError.
        """
        with self._database.read() as session:
            policy = policy_of(session.get_one(Study, caller.study_id))
        photos = {
            slot: prepare_photo(slot, file, max_pixels=self._settings.max_photo_pixels, policy=policy)
            for slot, file in files.items()
        }
        return self._keep(caller, client_id, None, photos, None)

    def _keep(
        self,
        caller: DeviceCaller,
        client_id: uuid.UUID,
        details: dict[str, Any] | None,
        photos: Mapping[str, SealablePhoto],
        captured_at: datetime | None,
    ) -> Submitted:
        meal_id = meal_id_of(caller.participant_id, client_id)
        tell(meal_id=str(meal_id))
        with self._database.read() as session:  # before sealing, so that a refused request leaves no blob
            known = self._check(session, session.get(Meal, meal_id), meal_id, details, photos, captured_at)
            keys = unspent_keys(
                session,
                {slot: _blob_key(caller.study_id, meal_id, slot, known.attempt, p) for slot, p in photos.items()},
            )
        there = set() if known.is_anew else set(known.stored)
        require_whole(self._children, caller, photos, there)
        seal_photos(self._blobs, photos, keys, there)
        sealed = _Sealed(known.attempt, keys, frozenset(set(photos) - there))
        try:
            try:
                return self._write(caller, meal_id, details, photos, sealed, captured_at)
            except IntegrityError:  # the same photograph came twice at the same time and the other was first
                return self._write(caller, meal_id, details, photos, sealed, captured_at)
        except GoneError:  # erased while this was sealed
            with self._database.write() as session:
                privacy.want_deleted(session, list(keys.values()), datetime.now(UTC))
            raise

    def _write(
        self,
        caller: DeviceCaller,
        meal_id: uuid.UUID,
        details: dict[str, Any] | None,
        photos: Mapping[str, SealablePhoto],
        sealed: _Sealed,
        captured_at: datetime | None,
    ) -> Submitted:
        now = datetime.now(UTC)
        with self._database.write() as session:
            participant = privacy.join_participant(session, caller.participant_id)
            if participant is None or participant.withdrawn_at is not None:
                raise has_left()
            require_unspent(session, sealed.keys.values())
            meal = self._meal(meals.lock_meal(session, meal_id), session, meal_id)
            known = self._check(session, meal, meal_id, details, photos, captured_at)
            stored = set() if known.is_anew else set(known.stored)
            if photos and (known.attempt != sealed.attempt or not set(photos) - stored <= sealed.slots):
                raise ConflictError("Another pair came in at the same time: GET the meal, then send again.")
            is_new = known.is_anew
            if known.is_anew:
                _start_anew(session, meal, known, now)
            if details is not None and meal.after_details is None:
                meal.after_details = details
                is_new = True
            added = {slot: photo for slot, photo in photos.items() if slot not in stored}
            session.add_all(image_row(meal_id, slot, photo, sealed.keys[slot], now) for slot, photo in added.items())
            if not (is_new or added):
                return Submitted(meal_id, is_new=False)
            meal.after_status = meal.after_status or "receiving"
            if added and stored | set(added) == set(AFTER_SLOTS):
                self._queue_estimate(session, meal, now)
            if known.is_anew:
                project_meal(session, meal)  # its records are no longer those of a pair that failed
            meal.version += 1
            audit.note(session, caller, "meal.receive", subject=meal.alias, slots=sorted(added))
        return Submitted(meal_id, is_new=True)

    def _meal(self, meal: Meal | None, session: Session, meal_id: uuid.UUID) -> Meal:
        if meal is None:
            if is_meal_deleted(session, self._box, meal_id):
                raise meal_deleted()
            raise NotFoundError("There is no such meal: send the meal before what was left of it.")
        return meal

    def _check(
        self,
        session: Session,
        meal: Meal | None,
        meal_id: uuid.UUID,
        details: Mapping[str, Any] | None,
        photos: Mapping[str, SealablePhoto],
        captured_at: datetime | None,
    ) -> _Known:
        """What is there, if what came can be kept beside it."""
        meal = self._meal(meal, session, meal_id)
        if meal.origin != "photographed":
            raise ConflictError(
                "This meal was told without photographs: there is nothing to compare an after-meal pair with.",
                code="meal_without_photographs",
            )
        if captured_at is not None and captured_at < meal.captured_at:
            raise InvalidInputError("The after-meal pair was taken before the meal.", code="after_pair_before_meal")
        stored = {image.slot: image for image in meals.images_of(session, meal_id) if image.slot in AFTER_SLOTS}
        other = [s for s, p in photos.items() if s in stored and stored[s].received_sha256 != p.received_sha256]
        known, told = meal.after_details or {}, details or {}
        changed = sorted(k for k in told if k not in ASIDE and told[k] != known.get(k))
        if changed:
            hints = (details or {}).get("hints", ())
            require_known_vessels(session, meal.study_id, hints)
            require_known_foods(session, hints)
            require_within(hints, photos.get("after_left") or stored.get("after_left"))
        attempt, _ = jobs.count_jobs(session, meal_id, "after")
        if meal.after_status == "failed":
            return _Known(stored, attempt, is_anew=bool(other or changed))
        if other:
            raise ConflictError(
                f"This meal already has another {other[0]} photograph.",
                code="after_pair_differs",
                slot=other[0],
                stored_sha256=stored[other[0]].received_sha256,
            )
        if changed and meal.after_details is not None:
            raise ConflictError(
                "Something else was told of this after-meal pair before.", code="after_pair_differs", fields=changed
            )
        if changed and meal.after_status not in ARRIVING:
            raise ConflictError(
                "The after-meal pair is queued already: tell of it before its second photograph.",
                code="after_pair_queued",
            )
        attempt -= meal.after_status not in ARRIVING  # the pair that is there has been given its job
        return _Known(stored, attempt, is_anew=False)

    def _queue_estimate(self, session: Session, meal: Meal, now: datetime) -> None:
        job = Job(id=uuid.uuid4(), meal_id=meal.id, purpose="after", state="queued", attempts=0, enqueued_at=now)
        meal.after_status = "queued"
        self._queue.enqueue(session, job)


def _start_anew(session: Session, meal: Meal, known: _Known, now: datetime) -> None:
    """Make room for another pair: the failed one's photographs go, its run stays."""
    erase_failed_pair(session, known.stored.values(), now)
    meal.after_status, meal.after_details = "receiving", None
    meal.after_failure_code = meal.after_failure_message = meal.after_failure_advice = None


def _blob_key(study_id: uuid.UUID, meal_id: uuid.UUID, slot: str, attempt: int, photo: SealablePhoto) -> str:
    """A later attempt has its own keys: the same bytes may be sent again while those of the failed one are deleted."""
    again = f"{attempt}/" if attempt else ""
    return f"{study_id}/{meal_id}/{slot}/{again}{photo.stored_sha256}"
