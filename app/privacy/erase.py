"""The only place that deletes: a meal, a person, photographs. Rows go in one transaction, blobs soon after it.

What is to go is committed as an intent (BlobDeletion) and carried out by privacy/delete_blobs.py; what was here is
remembered by tombstones, whose digests name nobody. Each erasure stands in the ledger before it begins
(privacy/erasure_ledger.py), leaves a receipt in numbers, and is noted in the audit log by aliases that lead nowhere.
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
from app.jobs import queries as jobs
from app.meals import queries as meals
from app.meals.models import Meal
from app.people import privacy_queries as people_privacy
from app.people.access import audit
from app.people.access.caller import Caller
from app.people.access.secret_box import SecretBox
from app.people.models import Participant
from app.people.privacy_models import ErasureReceipt
from app.people.tombstones import Deed, Kind, digest_of, meal_deleted
from app.privacy import announce
from app.privacy import queries as privacy
from app.privacy.erase_files import erase_meal_from_files
from app.privacy.erasure_ledger import Erasure, ErasureLedger
from app.privacy.queries import Ids
from app.records import queries as records
from app.records.read_meal import find_meal
from app.storage.blob_store import BlobMissingError


@dataclass(frozen=True, slots=True)
class Eraser:
    """What erasures need; one a process."""

    database: Database
    box: SecretBox
    ledger: ErasureLedger

    def erase_meal(self, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None) -> ErasureReceipt:
        """Erase one meal and all that hangs on it. Raises NotFoundError, ConflictError, GoneError (`meal_deleted`)."""
        with self.database.read() as session:
            meal_id = find_meal(session, caller, client_id, participant_code)[0].id
        receipt = self.carry_out_on_meal(self.intend("meal", "erase", meal_id), meal_id, caller)
        if receipt is None:
            raise meal_deleted()
        return receipt

    def intend(self, kind: Kind, deed: Deed, thing_id: uuid.UUID) -> Erasure:
        """Write the erasure into the ledger: from here on it happens.

        One that stands there already is the same one: who asks again after a crash gets the receipt that a restore
        would bring back. Two who ask at the same moment, before either has written, give it one id as well, since that
        follows from what is erased; which of their two times a restore tells is whose write came last.
        """
        digest = digest_of(self.box, kind, deed, thing_id)
        with contextlib.suppress(BlobMissingError):
            return self.ledger.read(kind, digest)
        receipt_id = uuid.UUID(self.box.digest("receipt", f"{kind} {digest}")[:32], version=4)
        erasure = Erasure(kind, deed, digest, receipt_id=receipt_id, at=datetime.now(UTC))
        self.ledger.write(erasure)
        return erasure

    def carry_out_on_meal(self, erasure: Erasure, meal_id: uuid.UUID, caller: Caller | None) -> ErasureReceipt | None:
        """Erase the meal; None if it is gone. caller None: the server itself, after a restore or a crash."""
        with self.database.write() as session:
            meal = meals.lock_meal(session, meal_id)
            if meal is None:
                return None
            study_id, alias, client_id = meal.study_id, meal.alias, meal.client_id
            code = session.get_one(Participant, meal.participant_id).code
            announce.meal_deleted(session, meal)
            counts = erase_meals(session, study_id, [meal], jobs.one_meal(meal_id), erasure)
            people_privacy.add_tombstones(session, "meal", [erasure.digest], erasure.at, study_id=study_id)
            receipt = add_receipt(session, erasure, study_id, what="meal", policy="erase", counts=counts)
            erase_meal_from_files(session, self.box, study_id, code, client_id)
            audit.note(session, caller, "meal.erase", study_id=study_id, subject=alias, receipt=str(receipt.id))
        self.database.empty_log()
        return receipt


def erase_meals(
    session: Session, study_id: uuid.UUID, gone: Collection[Meal], query: Ids, erasure: Erasure
) -> dict[str, int]:
    """Remove the rows of locked meals (gone, and as a query), and want their blobs deleted; table -> rows removed.

    Everything below `study/meal/` goes: also what an upload or a run sealed there and never came to write down.
    """
    folders = {f"{study_id}/{meal.id}/" for meal in gone}
    keys = privacy.blob_keys_of(session, query)
    elsewhere = {key for key in keys if not _is_below(key, folders)}
    people_privacy.want_deleted(session, folders | elsewhere, erasure.at)
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
    """Photographs and derived pictures of locked meals: their blobs are to go, what was measured stays."""
    photographs = privacy.mark_images_erased(session, query, now)
    derived = privacy.delete_artefacts(session, query)
    people_privacy.want_deleted(session, [*photographs, *derived], now)
    privacy.touch_meals(session, query)
    return {"photographs": len(photographs), "derived_pictures": len(derived)}


def add_receipt(
    session: Session, erasure: Erasure, study_id: uuid.UUID, *, what: str, policy: str, counts: dict[str, int]
) -> ErasureReceipt:
    """The receipt, under the id that the ledger has: after a restore it is the same one again."""
    receipt = ErasureReceipt(
        id=erasure.receipt_id,
        study_id=study_id,
        what=what,
        policy=policy,
        counts={name: count for name, count in counts.items() if count},
        erased_at=erasure.at,
    )
    session.add(receipt)
    session.flush()
    return receipt


def find_receipt(database: Database, receipt_id: uuid.UUID) -> ErasureReceipt:
    """A receipt, for whoever holds its id. Raises NotFoundError."""
    with database.read() as session:
        receipt = session.get(ErasureReceipt, receipt_id)
    if receipt is None:
        raise NotFoundError("There is no such receipt.")
    return receipt


def public_digest(public_id: uuid.UUID) -> str:
    """SHA-256 of an item's or a day's id as text: whoever pulled it can make the digest, nobody else."""
    return hashlib.sha256(str(public_id).encode()).hexdigest()


def _is_below(key: str, folders: set[str]) -> bool:
    return "/".join(key.split("/")[:2]) + "/" in folders
