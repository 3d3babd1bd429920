"""Erase meals, participants and photographs; nothing else deletes them.

Rows go in one transaction, blobs soon after. The transaction schedules blobs for deletion
(BlobDeletion), which privacy/delete_blobs.py carries out, and adds tombstones, whose digests
identify nobody. Each erasure is written to the ledger before it begins (privacy/erasure_ledger.py),
leaves a receipt with numbers, and is noted in the audit log by aliases that no row resolves any
more. Files made from a study's rows follow at the end of the transaction, after its receipt:
exports expire, releases lose the erased rows (exports/queries.py explains why). Webhooks are told.
"""

import contextlib
import hashlib
import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import NotFoundError
from app.db.session import Database
from app.exports import queries as exports
from app.exports.releases import queries as releases
from app.exports.releases.digests import meal_digest, participant_digest
from app.jobs import queries as jobs
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal
from app.outbox.write import announce
from app.people import privacy_queries as people_privacy
from app.people.access import audit
from app.people.access.caller import Caller
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, WithdrawalPolicy
from app.people.privacy_models import ErasureReceipt
from app.people.tombstones import Kind, digest_of, public_digest
from app.privacy import queries as privacy
from app.privacy.erasure_ledger import Erasure, ErasureLedger
from app.privacy.queries import Ids
from app.records import queries as records
from app.records.read_meal import find_meal
from app.storage.blob_store import BlobMissingError


@dataclass(frozen=True, slots=True)
class Eraser:
    """The dependencies of erasures; one per process."""

    database: Database
    box: SecretBox
    ledger: ErasureLedger

    def erase_meal(
        self, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
    ) -> ErasureReceipt:
        """Erase a meal and all its rows; concurrent calls get one receipt.

        Raises NotFoundError, ConflictError.
        """
        with self.database.read() as session:
            meal_id = find_meal(session, caller, client_id, participant_code)[0].id
        erasure = self.intend("meal", "erase", meal_id)
        receipt = self.carry_out_on_meal(erasure, meal_id, caller)
        return receipt if receipt is not None else find_receipt(self.database, erasure.receipt_id)

    def intend(self, kind: Kind, policy: WithdrawalPolicy, subject_id: uuid.UUID) -> Erasure:
        """Write an erasure to the ledger; from then on it will be carried out.

        An entry that exists already is returned, so that a request repeated after a crash gets the
        same receipt as a restore would. Concurrent requests get the same receipt id too, since it
        is derived from the digest; only the time of the entry is that of the last writer.
        """
        digest = digest_of(self.box, kind, policy, subject_id)
        with contextlib.suppress(BlobMissingError):
            return self.ledger.read(kind, digest)
        receipt_id = uuid.UUID(self.box.digest("receipt", f"{kind} {digest}")[:32], version=4)
        erasure = Erasure(kind, policy, digest, receipt_id=receipt_id, at=datetime.now(UTC))
        self.ledger.write(erasure)
        return erasure

    def carry_out_on_meal(
        self, erasure: Erasure, meal_id: uuid.UUID, caller: Caller | None
    ) -> ErasureReceipt | None:
        """Erase a meal; None if it no longer exists.

        caller None: the server itself, after a restore or a crash.
        """
        with self.database.write() as session:
            meal = meals.lock_meal(session, meal_id)
            if meal is None:
                return None
            study_id, alias, client_id = meal.study_id, meal.alias, meal.client_id
            code = session.get_one(Participant, meal.participant_id).code
            announce_meal_deletion(session, meal)
            counts = erase_meals(session, study_id, [meal], jobs.one_meal(meal_id), erasure)
            people_privacy.add_tombstones(
                session, "meal", [erasure.digest], erasure.at, study_id=study_id
            )
            receipt = add_receipt(session, erasure, study_id, counts)
            erase_meal_from_files(session, self.box, study_id, code, client_id)
            audit.note(
                session,
                caller,
                "meal.erase",
                study_id=study_id,
                subject=alias,
                receipt=str(receipt.id),
            )
        self.database.empty_log()
        return receipt


def erase_meals(
    session: Session, study_id: uuid.UUID, meals: Collection[Meal], query: Ids, erasure: Erasure
) -> dict[str, int]:
    """Delete the rows of locked meals and schedule their blobs.

    query: the meals' ids. Returns rows deleted by table.

    All blobs below `study/meal/` are deleted, also those that an upload or a run sealed but never
    committed.
    """
    folders = {f"{study_id}/{meal.id}/" for meal in meals}
    keys = privacy.blob_keys_of(session, query)
    elsewhere = {key for key in keys if not _is_below(key, folders)}
    people_privacy.schedule_deletion(session, folders | elsewhere, erasure.at)
    item_ids = privacy.record_ids(session, query)
    counts = privacy.delete_meals(session, query)
    if item_ids:
        people_privacy.add_tombstones(
            session,
            "record",
            [public_digest(item_id) for item_id in item_ids],
            erasure.at,
            study_id=study_id,
            change_seq=records.next_change_seq(session, study_id),
        )
    return counts


def erase_pictures(session: Session, query: Ids, now: datetime) -> dict[str, int]:
    """Erase photographs and derived pictures of locked meals; measurements stay.

    Returns the counts.
    """
    photographs = privacy.mark_images_erased(session, query, now)
    derived = privacy.delete_artefacts(session, query)
    people_privacy.schedule_deletion(session, [*photographs, *derived], now)
    privacy.touch_meals(session, query)
    return {"photographs": len(photographs), "derived_pictures": len(derived)}


def add_receipt(
    session: Session, erasure: Erasure, study_id: uuid.UUID, counts: dict[str, int]
) -> ErasureReceipt:
    """Add an erasure's receipt with the id of the ledger, so that it is the same one again after a restore."""
    receipt = ErasureReceipt(
        id=erasure.receipt_id,
        study_id=study_id,
        what=erasure.kind,
        policy=erasure.policy,
        counts={name: count for name, count in counts.items() if count},
        erased_at=erasure.at,
    )
    session.add(receipt)
    session.flush()
    return receipt


def find_receipt(database: Database, receipt_id: uuid.UUID) -> ErasureReceipt:
    """Return a receipt; its id is the only credential needed. Raises NotFoundError."""
    with database.read() as session:
        receipt = session.get(ErasureReceipt, receipt_id)
    if receipt is None:
        raise NotFoundError("There is no such receipt.")
    return receipt


def _is_below(key: str, folders: set[str]) -> bool:
    return "/".join(key.split("/")[:2]) + "/" in folders


def erase_meal_from_files(
    session: Session,
    box: SecretBox,
    study_id: uuid.UUID,
    participant_code: str,
    client_id: uuid.UUID,
) -> None:
    """Erase a meal, which files identify by its participant's code and the phone's id."""
    exports.erase_from_exports(session, study_id, None)
    releases.erase_from_releases(
        session, study_id, "meal", meal_digest(box, participant_code, client_id)
    )


def erase_person_from_files(
    session: Session,
    box: SecretBox,
    study_id: uuid.UUID,
    participant_code: str,
    renamed: tuple[str, uuid.UUID] | None,
) -> None:
    """Erase or anonymise a participant, whom files identify by code.

    renamed: new code and seed of new meal ids.
    """
    exports.erase_from_exports(session, study_id, participant_code)
    deed: releases.Deed = "erase" if renamed is None else "anonymise"
    releases.erase_from_releases(
        session, study_id, deed, participant_digest(box, participant_code), renamed
    )


def announce_meal_deletion(session: Session, meal: Meal) -> None:
    """Announce that a meal is about to be erased.

    Its id is sent as SHA-256, which only holders of the id recognise.
    """
    participant = session.get_one(Participant, meal.participant_id)
    digest = hashlib.sha256(str(meal.client_id).encode()).hexdigest()
    announce(
        session,
        meal.study_id,
        "meal.deleted",
        {"participant": participant.code, "meal_sha256": digest},
        participant_id=participant.id,
    )


def announce_withdrawal(
    session: Session, participant: Participant, policy: WithdrawalPolicy
) -> None:
    """Announce that a participant leaves the study.

    The delivery outlives the participant's rows, so it does not refer to them; its payload is
    removed once it is delivered (webhooks/deliver_webhooks.py).
    """
    announce(
        session,
        participant.study_id,
        "participant.withdrawn",
        {"participant": participant.code, "policy": policy},
    )
