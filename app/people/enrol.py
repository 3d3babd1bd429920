"""Enrol a participant's phone: issue a one-time code and exchange it once for a token."""

import uuid
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, DeviceCaller, new_code, new_token, sha256_hex
from app.people.models import AccessToken, Device, Enrolment, Study
from app.people.participants import require_participant

ENROLMENT_VALID = timedelta(days=7)


@dataclass(frozen=True, slots=True)
class IssuedCode:
    """An enrolment code, shown once."""

    code: str
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class NewDevice:
    """A phone as it describes itself."""

    name: str
    model: str | None = None
    app_version: str | None = None


@dataclass(frozen=True, slots=True)
class IssuedDevice:
    """A device's token, shown once. study, participant: their codes."""

    token: str
    device_id: uuid.UUID
    participant: str
    study: str
    marker: str | None


def issue_enrolment_code(
    database: Database, *, study_code: str, participant_code: str, caller: Caller | None = None
) -> IssuedCode:
    """Issue a one-time code for a participant's next device; earlier unused codes end.

    Raises NotFoundError, ConflictError (`participant_withdrawn`).
    """
    code, now = new_code(), datetime.now(UTC)
    with database.write() as session:
        study, participant = require_participant(session, study_code, participant_code, lock=True)
        if participant.withdrawn_at is not None:
            raise ConflictError("This participant has left the study.", code="participant_withdrawn")
        people.end_enrolments(session, participant.id, now)
        session.add(
            Enrolment(
                id=uuid.uuid4(),
                participant_id=participant.id,
                code_sha256=sha256_hex(code),
                expires_at=now + ENROLMENT_VALID,
                created_at=now,
            )
        )
        note(session, caller, "enrolment_code.issue", study_id=study.id, subject=participant.alias)
    return IssuedCode(code=code, expires_at=now + ENROLMENT_VALID)


def enrol_device(database: Database, *, code: str, device: NewDevice) -> IssuedDevice:
    """Exchange a code for a device's token, once. Raises NotFoundError for an unknown, used or expired code."""
    token, now = new_token(), datetime.now(UTC)
    with database.write() as session:
        participant = privacy.join_participant(session, people.participant_of_code(session, sha256_hex(code)))
        enrolment = people.take_enrolment(session, sha256_hex(code), now)
        if participant is None or participant.withdrawn_at is not None or enrolment is None:
            raise NotFoundError(
                "This enrolment code is unknown, used or expired. Ask the study for a new one.",
                code="enrolment_code_invalid",
            )
        study = session.get_one(Study, participant.study_id)
        row = Device(
            id=uuid.uuid4(),
            participant_id=participant.id,
            name=device.name,
            model=device.model,
            app_version=device.app_version,
            enrolled_at=now,
        )
        session.add(row)
        session.flush()
        session.add(
            AccessToken(
                id=uuid.uuid4(), token_sha256=sha256_hex(token), kind="device", device_id=row.id, created_at=now
            )
        )
        phone = DeviceCaller(row.id, participant.id, study.id, participant.alias)
        note(session, phone, "device.enrol", subject=participant.alias)
    return IssuedDevice(
        token=token,
        device_id=row.id,
        participant=participant.code,
        study=study.code,
        marker=study.marker,
    )
