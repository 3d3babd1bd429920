"""List participants' phones and revoke their tokens, as the study's owner or the phone itself."""

import uuid
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import NotFoundError
from app.db.session import Database
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.models import Device, Participant, Study
from app.people.participants import withdrawn_error
from app.people.studies import load_study


def list_devices(
    database: Database,
    study_code: str,
    participant_code: str | None,
    *,
    cursor: str | None,
    limit: int,
) -> Page[tuple[Device, str]]:
    """Return a page of (phone, its participant's code) of a study, the last enrolled first."""
    list_name = f"devices of {study_code} {participant_code or ''}"
    after = decode_cursor(list_name, cursor, INSTANT, ID)
    with database.read() as session:
        study = load_study(session, study_code)
        rows = people.page_of_devices(
            session, study.id, participant_code, after=after, limit=limit + 1
        )
    return page_of(list_name, rows, limit, lambda row: (row[0].enrolled_at, row[0].id))


def revoke_device(
    database: Database, caller: StaffCaller, study_code: str, device_id: uuid.UUID
) -> None:
    """End a phone's token; repeating it changes nothing. Raises NotFoundError."""
    with database.write() as session:
        study = load_study(session, study_code)
        device = session.get(Device, device_id)
        participant = session.get(Participant, device.participant_id) if device else None
        if device is None or participant is None or participant.study_id != study.id:
            raise NotFoundError("There is no such device.")
        _revoke(session, caller, device, participant)


def sign_out_phone(database: Database, caller: DeviceCaller) -> None:
    """End the calling phone's token. Raises GoneError: its participant left meanwhile."""
    with database.write() as session:
        participant = privacy.join_participant(session, caller.participant_id)
        device = session.get(Device, caller.device_id)
        if participant is None or device is None:
            raise withdrawn_error()
        _revoke(session, caller, device, participant)


def read_phone(
    database: Database, caller: DeviceCaller
) -> tuple[Study, Participant, Device, datetime]:
    """Return a phone's study, its participant, the phone, and when the participant joined.

    Raises GoneError: its participant left meanwhile.
    """
    with database.read() as session:
        participant, device = (
            session.get(Participant, caller.participant_id),
            session.get(Device, caller.device_id),
        )
        if participant is None or device is None:
            raise withdrawn_error()
        joined_at = people.first_enrolment(session, participant.id)
        return session.get_one(Study, caller.study_id), participant, device, joined_at


def _revoke(session: Session, caller: Caller, device: Device, participant: Participant) -> None:
    now = datetime.now(UTC)
    if device.revoked_at is None:
        device.revoked_at = now
        people.end_tokens_of_device(session, device.id, now)
        note(
            session,
            caller,
            "device.revoke",
            study_id=participant.study_id,
            subject=participant.alias,
        )
