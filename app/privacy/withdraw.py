"""Withdraw a participant from a study: by the study's policy their data are kept, anonymised or erased.

In all three cases the tokens of their phones become tombstones (a call with one gets 410
`withdrawn`), their enrolment codes end, and a receipt gives the numbers of rows. docs/privacy.md
describes what "anonymise" leaves, and why.
"""

import secrets
import uuid
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import cast

from sqlalchemy.orm import Session

from app.children.faults import PHOTOGRAPH_ERASED
from app.core.errors import ConflictError, NotFoundError
from app.db.session import despite_deadlocks
from app.jobs import queries as jobs
from app.meals.stored.models import Meal, MealDetails, PairDetails
from app.people import privacy_queries as people_privacy
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.models import WITHDRAWAL_POLICIES, Enrolment, Participant, Study
from app.people.participants import withdrawn_error
from app.people.privacy_models import ErasureReceipt
from app.people.studies import enter_study
from app.people.tombstones import digest_of, public_digest, spend_code
from app.privacy import queries as privacy
from app.privacy.erase import (
    Eraser,
    add_receipt,
    announce_withdrawal,
    erase_meals,
    erase_person_from_files,
    erase_pictures,
    find_receipt,
)
from app.privacy.erasure_ledger import Erasure
from app.records import queries as records
from app.records.project_records import project_meal

WITHDRAWN = "withdrawn"  # replaces names
KEPT_DETAILS = ("captured_at", "time_zone", "marker", "camera", "rig")
NO_DETAILS: dict[str, object] = {"hints": [], "location": None, "app_version": None}
# the one value of events that people write in their own words (records/review/review_meal.py)
FREE_TEXT = "text"


def withdraw_self(eraser: Eraser, caller: DeviceCaller) -> ErasureReceipt:
    """Withdraw the participant of the calling phone; concurrent calls get the same receipt.

    Raises GoneError if they have left already.
    """
    with eraser.database.read() as session:
        participant = session.get(Participant, caller.participant_id)
        if participant is None or participant.withdrawn_at is not None:
            raise withdrawn_error()
        policy = session.get_one(Study, participant.study_id).withdrawal_policy
    erasure = eraser.intend("participant", policy, caller.participant_id)
    receipt = carry_out_on_participant(eraser, erasure, caller.participant_id, caller)
    return receipt if receipt is not None else find_receipt(eraser.database, erasure.receipt_id)


def withdraw_participant(
    eraser: Eraser, caller: StaffCaller, study_code: str, participant_code: str
) -> ErasureReceipt:
    """Withdraw a participant as an owner; possible again once the study's policy erases more than the first time.

    Raises NotFoundError, ConflictError (`participant_withdrawn`: already withdrawn by this policy
    or a stronger one).
    """
    already_withdrawn = ConflictError(
        "This participant has already left the study under the same policy.",
        code="participant_withdrawn",
    )
    with eraser.database.read() as session:
        study = enter_study(session, caller, study_code)
        participant = people.find_participant(session, study.id, participant_code)
        if participant is None:
            raise NotFoundError("There is no such participant in this study.")
        policy, participant_id = study.withdrawal_policy, participant.id
        at_least = WITHDRAWAL_POLICIES[WITHDRAWAL_POLICIES.index(policy) :]
        digests = [
            digest_of(eraser.box, "participant", stronger, participant_id) for stronger in at_least
        ]
        if people_privacy.tombstones_among(session, "participant", digests):
            raise already_withdrawn
    receipt = carry_out_on_participant(
        eraser, eraser.intend("participant", policy, participant_id), participant_id, caller
    )
    if receipt is None:
        raise already_withdrawn
    return receipt


def carry_out_on_participant(
    eraser: Eraser, erasure: Erasure, participant_id: uuid.UUID, caller: Caller | None
) -> ErasureReceipt | None:
    """End the phones and apply the policy in one transaction; None if it was done before or the participant is erased.

    It locks the participant, then their meals. An estimate being saved holds its meal and needs the
    participant: then PostgreSQL aborts one of the two, and the withdrawal is retried.
    """
    return despite_deadlocks(lambda: _withdraw(eraser, erasure, participant_id, caller))


def _withdraw(
    eraser: Eraser, erasure: Erasure, participant_id: uuid.UUID, caller: Caller | None
) -> ErasureReceipt | None:
    with eraser.database.write() as session:
        # before enrolments, as everywhere
        participant = people_privacy.lock_participant(session, participant_id)
        if participant is None or people_privacy.tombstones_among(
            session, "participant", [erasure.digest]
        ):
            return None
        study = session.get_one(Study, participant.study_id)
        enrolments = (
            people_privacy.enrolments_of(session, participant_id) if study.is_sandbox else []
        )
        people_privacy.end_enrolments(session, participant_id)
        study_id, alias, code = participant.study_id, participant.alias, participant.code
        new_ids = uuid.uuid4()
        tokens = people_privacy.end_tokens(session, participant_id)
        ended = [eraser.box.digest("token", token_sha256) for token_sha256 in tokens]
        people_privacy.add_tombstones(session, "token", ended, erasure.at, study_id=study_id)
        # while the row has the code that receivers know
        announce_withdrawal(session, participant, erasure.policy)
        if erasure.policy != "keep" and not study.is_sandbox:
            spend_code(session, eraser.box, participant, erasure.at)
        counts = {"access_token": len(ended)} | _apply_policy(
            session, participant, erasure, new_ids
        )
        if enrolments:
            _begin_anew(session, study_id, code, enrolments, erasure.at)
        people_privacy.add_tombstones(
            session, "participant", [erasure.digest], erasure.at, study_id=study_id
        )
        receipt = add_receipt(session, erasure, study_id, counts)
        if erasure.policy != "keep":
            renamed = (participant.code, new_ids) if erasure.policy == "anonymise" else None
            erase_person_from_files(session, eraser.box, study_id, code, renamed)
        audit.note(
            session,
            caller,
            "participant.withdraw",
            study_id=study_id,
            subject=alias,
            policy=erasure.policy,
            receipt=str(receipt.id),
        )
    eraser.database.empty_log()
    return receipt


def _begin_anew(
    session: Session, study_id: uuid.UUID, code: str, enrolments: Sequence[Enrolment], now: datetime
) -> None:
    """Create a participant with the code of an erased one of a sandbox, whose enrolment codes never run out."""
    successor = Participant(id=uuid.uuid4(), study_id=study_id, code=code, created_at=now)
    session.add(successor)
    session.flush()
    session.add_all(
        Enrolment(
            id=uuid.uuid4(),
            participant_id=successor.id,
            code_sha256=each.code_sha256,
            expires_at=each.expires_at,
            created_at=each.created_at,
        )
        for each in enrolments
    )
    session.flush()


def _apply_policy(
    session: Session, participant: Participant, erasure: Erasure, new_ids: uuid.UUID
) -> dict[str, int]:
    if erasure.policy == "erase":
        return _erase(session, participant, erasure)
    for device in people_privacy.devices_of(session, participant.id):
        device.revoked_at = device.revoked_at or erasure.at
    participant.withdrawn_at = participant.withdrawn_at or erasure.at
    return (
        _anonymise(session, participant, erasure.at, new_ids)
        if erasure.policy == "anonymise"
        else {}
    )


def _erase(session: Session, participant: Participant, erasure: Erasure) -> dict[str, int]:
    participant_id, study_id = participant.id, participant.study_id
    meals = privacy.lock_meals_of(session, participant_id)
    counts = erase_meals(session, study_id, meals, privacy.meals_of(participant_id), erasure)
    days = [public_digest(day_id) for day_id in privacy.day_ids(session, participant_id)]
    if days:
        number = records.next_change_seq(session, study_id)
        people_privacy.add_tombstones(
            session, "day", days, erasure.at, study_id=study_id, change_seq=number
        )
    for table, count in privacy.delete_participant(session, participant_id).items():
        counts[table] = counts.get(table, 0) + count
    return counts


def _anonymise(
    session: Session, participant: Participant, now: datetime, new_ids: uuid.UUID
) -> dict[str, int]:
    """Keep what was eaten and when, under a new code; erase what identifies the person or shows their food.

    new_ids: namespace of the meals' new ids, here and in releases; it is stored nowhere.
    """
    meals = privacy.lock_meals_of(session, participant.id)
    meal_ids = privacy.meals_of(participant.id)
    # first, so that no job computes from the pictures any more
    for job in jobs.live_jobs_of(session, meal_ids):
        meal = session.get_one(Meal, job.meal_id)
        jobs.fail_job(job, meal, PHOTOGRAPH_ERASED, now)
        session.flush()
        project_meal(session, meal)
    counts = erase_pictures(session, meal_ids, now)
    counts |= privacy.delete_identifying_rows(session, participant.id, meal_ids)
    for meal in meals:
        meal.client_id, meal.alias = uuid.uuid5(new_ids, str(meal.client_id)), uuid.uuid4()
        meal.details = cast(MealDetails, _without_person(meal.details))
        if meal.after_details is not None:
            meal.after_details = cast(PairDetails, _without_person(meal.after_details))
    for event in privacy.events_of(session, meal_ids):
        if FREE_TEXT in event.new:
            # a hash of few words tells them
            event.new, event.request_sha256 = (event.new | {FREE_TEXT: ""}, "")
    for day_event in privacy.day_events_of(session, participant.id):
        if day_event.layer == "participant":
            day_event.author = WITHDRAWN
    for device in people_privacy.devices_of(session, participant.id):
        device.name, device.model, device.app_version = WITHDRAWN, None, None
        device.clock_skew_seconds = device.last_used_at = None
    participant.code, participant.alias = f"{WITHDRAWN}-{secrets.token_hex(8)}", uuid.uuid4()
    participant.profile = participant.favourites = None
    participant.visit = participant.excluded = None  # free text; the arm stays, as what was eaten
    number = records.next_change_seq(session, participant.study_id)
    privacy.touch_records_and_days(session, participant.id, number)
    return counts | {"meals_anonymised": len(meals)}


def _without_person(details: Mapping[str, object]) -> dict[str, object]:
    return {name: details[name] for name in KEPT_DETAILS if name in details} | NO_DETAILS
