"""Erase photographs and derived pictures older than the study's retention_days, counted from their upload.

Measurements stay: items, records, runs without pictures. Of a sandbox study nothing stays for
longer than a day.
"""

import uuid
from datetime import UTC, datetime, timedelta

import structlog

from app.db.session import Database
from app.metrics import instruments
from app.people.access import audit
from app.people.privacy_models import ErasureReceipt
from app.privacy import queries as privacy
from app.privacy.erase import Eraser, erase_pictures
from app.privacy.withdraw import carry_out_on_participant

log = structlog.get_logger()

SANDBOX_KEEPS = timedelta(days=1)
BATCH = 100  # meals per transaction, for which uploads may have to wait


def erase_old_pictures(database: Database, now: datetime | None = None) -> int:
    """Erase old pictures in every study. Returns the number of meals that lost pictures."""
    now = now or datetime.now(UTC)
    with database.read() as session:
        due = [
            (study.id, now - timedelta(days=study.retention_days))
            for study in privacy.studies_with_retention(session)
            if study.retention_days is not None
        ]
    total = 0
    for study_id, before in due:
        while count := _erase_batch(database, study_id, before, now):
            total += count
    return total


def erase_sandboxes(eraser: Eraser, now: datetime | None = None) -> int:
    """Erase the participants of sandbox studies who sent something, or enrolled, over a day ago.

    Returns how many.
    """
    before = (now or datetime.now(UTC)) - SANDBOX_KEEPS
    with eraser.database.read() as session:
        due = privacy.sandbox_participants_since(session, before)
    for participant_id in due:
        erasure = eraser.intend("participant", "erase", participant_id)
        carry_out_on_participant(eraser, erasure, participant_id, None)
    return len(due)


def _erase_batch(database: Database, study_id: uuid.UUID, before: datetime, now: datetime) -> int:
    with database.write() as session:
        meal_ids = privacy.meals_with_old_pictures(session, study_id, before, BATCH)
        if not meal_ids:
            return 0
        counts = erase_pictures(session, privacy.ids_in(meal_ids), now) | {"meals": len(meal_ids)}
        receipt = ErasureReceipt(
            id=uuid.uuid4(),
            study_id=study_id,
            what="photographs",
            policy="retention",
            counts=counts,
            erased_at=now,
        )
        session.add(receipt)
        audit.note(
            session,
            None,
            "photographs.erase",
            study_id=study_id,
            receipt=str(receipt.id),
            counts=counts,
        )
    instruments.PHOTOGRAPHS_ERASED.inc(counts["photographs"])
    log.info(
        "photographs_erased",
        study_id=str(study_id),
        receipt=str(receipt.id),
        before=before.isoformat(),
        **counts,
    )
    return len(meal_ids)
