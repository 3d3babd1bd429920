"""Photographs do not stay longer than the study says: past retention_days they and the pictures made of them go.

By the time of upload, which the server's clock told. What was measured stays: items, records, runs without pictures.
"""

import uuid
from datetime import UTC, datetime, timedelta

from app.db.session import Database
from app.people.access import audit
from app.people.privacy_models import ErasureReceipt
from app.privacy import queries as privacy
from app.privacy.erase import erase_pictures

BATCH = 100  # meals a transaction: uploads wait for no more than that


def erase_old_pictures(database: Database, now: datetime | None = None) -> int:
    """Erase what is past its time in every study. Returns how many meals lost their pictures."""
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


def _erase_batch(database: Database, study_id: uuid.UUID, before: datetime, now: datetime) -> int:
    with database.write() as session:
        found = privacy.meals_with_old_pictures(session, study_id, before, BATCH)
        if not found:
            return 0
        counts = erase_pictures(session, privacy.ids_in(found), now) | {"meals": len(found)}
        receipt = ErasureReceipt(
            id=uuid.uuid4(), study_id=study_id, what="photographs", policy="retention", counts=counts, erased_at=now
        )
        session.add(receipt)
        audit.note(session, None, "photographs.erase", study_id=study_id, receipt=str(receipt.id), counts=counts)
    return len(found)
