"""Participants' phones: enrolled by a one-time code, listed, revoked.

A code, as text or QR code, is exchanged once for a token. For an app the QR code's text is JSON,
not a link: another app can intercept a link, and links end up in histories and logs. For a browser
it is a link to the capture page. The code stands after the #, which no browser sends to a server,
and the page removes it from the address at once. The study's owner or the phone itself ends its
token.
"""

import io
import json
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import segno
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import (
    Caller,
    DeviceCaller,
    StaffCaller,
    new_code,
    new_token,
    sha256_hex,
    token_of,
)
from app.people.access.secret_box import SecretBox
from app.people.models import AccessToken, Device, Enrolment, Participant, Study
from app.people.participants import require_participant, withdrawn_error
from app.people.studies import load_study

ENROLMENT_VALID = timedelta(days=7)
SANDBOX_ENROLMENT_VALID = timedelta(days=36_525)  # a century
SCALE = 8  # pixels per module of the PNG: about 400 pixels per side, sharp on a screen
ERROR_LEVEL = "m"  # up to 15 % may be covered: fingers, glare, a fold


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
    """A device's token.

    study, participant: their codes. is_new: False if the phone asks again with its secret.
    """

    token: str
    device_id: uuid.UUID
    participant: str
    study: str
    marker: str | None
    is_new: bool


def issue_enrolment_code(
    database: Database, *, study_code: str, participant_code: str, caller: Caller | None = None
) -> IssuedCode:
    """Issue a one-time code for a participant's next device; earlier unused codes end.

    The code of a sandbox study works any number of times until another one is issued.
    Raises NotFoundError, ConflictError (`participant_withdrawn`).
    """
    code, now = new_code(), datetime.now(UTC)
    with database.write() as session:
        study, participant = require_participant(session, study_code, participant_code, lock=True)
        if participant.withdrawn_at is not None:
            raise ConflictError(
                "This participant has left the study.", code="participant_withdrawn"
            )
        people.end_enrolments(session, participant.id, now)
        expires_at = now + (SANDBOX_ENROLMENT_VALID if study.is_sandbox else ENROLMENT_VALID)
        session.add(
            Enrolment(
                id=uuid.uuid4(),
                participant_id=participant.id,
                code_sha256=sha256_hex(code),
                expires_at=expires_at,
                created_at=now,
            )
        )
        note(session, caller, "enrolment_code.issue", study_id=study.id, subject=participant.alias)
    return IssuedCode(code=code, expires_at=expires_at)


def enrol_device(
    database: Database, box: SecretBox, *, code: str, device: NewDevice, secret: str | None = None
) -> IssuedDevice:
    """Exchange a code for a device's token, once; the phone that used it gets the same token again.

    secret: drawn by the phone. The token is derived from it under the server's key, so that nobody
    but this phone can ask again, as long as the token is valid. Raises NotFoundError for an
    unknown, used or expired code, and for a secret whose token has ended, also with a sandbox's
    code.
    """
    token = (
        new_token() if secret is None else token_of(box.digest("device.token", f"{code}\0{secret}"))
    )
    now = datetime.now(UTC)
    with database.write() as session:
        participant = privacy.join_participant(
            session, people.participant_of_code(session, sha256_hex(code))
        )
        # a sandbox's, time and again
        is_taken = people.take_enrolment(session, sha256_hex(code), now) is not None
        token_sha256 = sha256_hex(token)
        issued = people.find_token(session, token_sha256, now, idle_since=now)
        is_new = is_taken and not people.is_token_used(
            session, token_sha256, box.digest("token", token_sha256)
        )
        if participant is None or participant.withdrawn_at is not None or not (is_new or issued):
            raise NotFoundError(
                "This enrolment code is unknown, used or expired. Ask the study for a new one.",
                code="enrolment_code_invalid",
            )
        study = session.get_one(Study, participant.study_id)
        device_id = (
            issued.Device.id if issued else _add_device(session, participant, device, token, now)
        )
    return IssuedDevice(
        token, device_id, participant.code, study.code, study.marker, issued is None
    )


def _add_device(
    session: Session, participant: Participant, device: NewDevice, token: str, now: datetime
) -> uuid.UUID:
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
            id=uuid.uuid4(),
            token_sha256=sha256_hex(token),
            kind="device",
            device_id=row.id,
            created_at=now,
        )
    )
    phone = DeviceCaller(row.id, participant.id, participant.study_id, participant.alias)
    note(session, phone, "device.enrol", subject=participant.alias)
    return row.id


def enrolment_text(server: str, code: str) -> str:
    """Return the QR code's text: {"tada": 1, "server": "https://...", "code": "..."}; tada: version of the format."""
    return json.dumps(
        {"tada": 1, "server": server, "code": code}, separators=(",", ":"), ensure_ascii=False
    )


def capture_link(server: str, code: str) -> str:
    """Return the link by which the capture page enrols a phone's browser."""
    return f"{server}/capture/#code={code}"


def qr_svg(text: str) -> str:
    """Draw a QR code as SVG to embed in a page, without a size of its own, with its quiet zone."""
    buffer = io.BytesIO()
    _qr(text).save(buffer, kind="svg", omitsize=True, xmldecl=False, light="#fff")
    return buffer.getvalue().decode()


def qr_png(text: str) -> bytes:
    """Draw a QR code as PNG, black on white with its quiet zone."""
    buffer = io.BytesIO()
    _qr(text).save(buffer, kind="png", scale=SCALE)
    return buffer.getvalue()


def _qr(text: str) -> segno.QRCode:
    return segno.make_qr(text, error=ERROR_LEVEL, boost_error=False)


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
