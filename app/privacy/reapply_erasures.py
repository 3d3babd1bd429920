"""Carry out erasures of the ledger that the database lacks, before serving: after a restore or a crash.

If the database has a tombstone for every erasure, nothing else is read. Otherwise the digests of
all ids are computed and compared.
"""

import uuid
from collections.abc import Iterable
from datetime import datetime

import structlog

from app.people import privacy_queries as people_privacy
from app.people.models import WITHDRAWAL_POLICIES, WithdrawalPolicy
from app.people.tombstones import Kind, digest_of
from app.privacy import queries as privacy
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import KINDS, Erasure
from app.privacy.withdraw import carry_out_on_participant
from app.storage.blob_store import BlobStore

log = structlog.get_logger()


def reapply_erasures(eraser: Eraser, blobs: BlobStore, before: datetime | None = None) -> int:
    """Carry out every erasure of the ledger, or those written before a time.

    Returns the number carried out.

    Raises SecretKeyError if the ledger was written under another key.
    """
    total = sum(_reapply(eraser, kind, before) for kind in KINDS)
    if total:
        log.warning("erasures_reapplied", count=total)
        BlobDeleter(eraser.database, blobs).delete_scheduled()
    return total


def _reapply(eraser: Eraser, kind: Kind, before: datetime | None) -> int:
    digests = set(eraser.ledger.digests(kind, before))
    with eraser.database.read() as session:
        pending = digests - people_privacy.tombstones_among(session, kind, digests)
    if not pending:
        return 0
    erasures = {digest: eraser.ledger.read(kind, digest) for digest in sorted(pending)}
    carried_out = 0
    for digest, subject_id in _find_subjects(eraser, kind, pending).items():
        erasure = erasures[digest]
        if kind == "meal":
            receipt = eraser.carry_out_on_meal(erasure, subject_id, None)
        else:
            receipt = carry_out_on_participant(eraser, erasure, subject_id, None)
        carried_out += receipt is not None
    _add_tombstones(eraser, kind, erasures.values())
    return carried_out


def _find_subjects(eraser: Eraser, kind: Kind, digests: set[str]) -> dict[str, uuid.UUID]:
    """Return the id of each meal or participant to erase, by digest; of several policies the weakest comes first."""
    subjects: dict[str, uuid.UUID] = {}
    with eraser.database.read() as session:
        list_ids = privacy.meal_ids if kind == "meal" else people_privacy.participant_ids
        policies: tuple[WithdrawalPolicy, ...] = (
            ("erase",) if kind == "meal" else WITHDRAWAL_POLICIES
        )
        for subject_id in list_ids(session):
            for policy in policies:
                digest = digest_of(eraser.box, kind, policy, subject_id)
                if digest in digests:
                    subjects[digest] = subject_id
    return subjects


def _add_tombstones(eraser: Eraser, kind: Kind, erasures: Iterable[Erasure]) -> None:
    """Add tombstones of erasures without rows (the backup is older than the rows), to skip them at the next start."""
    with eraser.database.write() as session:
        for erasure in erasures:
            people_privacy.add_tombstones(
                session, kind, [erasure.digest], erasure.at, study_id=None
            )
