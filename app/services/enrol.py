"""People come in: admins, studies, participants, enrolment codes, and the device that swaps a code for a token."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy.exc import IntegrityError

from app.db.models import AccessToken, Device, Enrolment, Participant, Staff, Study
from app.db.queries import people
from app.db.session import Database
from app.errors import ConflictError, NotFoundError
from app.services.access import known_studies
from app.services.caller import StaffCaller, new_code, new_token, sha256_hex

ENROLMENT_VALID = timedelta(days=7)


@dataclass(frozen=True, slots=True)
class IssuedCode:
    """An enrolment code, shown once."""

    code: str
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class IssuedDevice:
    """A device's token, shown once."""

    token: str
    device_id: uuid.UUID
    participant_code: str
    study_code: str
    marker: str | None


def create_admin(database: Database, name: str) -> str:
    """A new admin's token. Raises ConflictError if the name is taken."""
    now, token = datetime.now(UTC), new_token()
    taken = ConflictError(f"There is already a staff member named {name!r}.", code="staff_exists")
    with _unless_taken(taken), database.write() as session:
        if people.find_staff(session, name) is not None:
            raise taken
        staff = Staff(id=uuid.uuid4(), name=name, is_admin=True, created_at=now)
        session.add(staff)
        session.flush()
        session.add(
            AccessToken(
                id=uuid.uuid4(),
                token_sha256=sha256_hex(token),
                kind="personal",
                name="made with the admin",
                staff_id=staff.id,
                created_at=now,
            ),
        )
    return token


def create_study(database: Database, *, code: str, name: str, marker: str | None, location_policy: str) -> Study:
    """A new study. Raises ConflictError if the code is taken."""
    taken = ConflictError(f"There is already a study {code!r}.", code="study_exists")
    with _unless_taken(taken), database.write() as session:
        if people.find_study(session, code) is not None:
            raise taken
        study = Study(
            id=uuid.uuid4(),
            code=code,
            name=name,
            marker=marker,
            location_policy=location_policy,
            change_seq=0,
            created_at=datetime.now(UTC),
        )
        session.add(study)
    return study


def list_studies(database: Database, caller: StaffCaller) -> list[Study]:
    """The studies where the caller has a role, by code; all of them for an admin."""
    known = known_studies(caller)
    with database.read() as session:
        return [study for study in people.list_studies(session) if known is None or study.id in known]


def create_participant(database: Database, *, study_code: str, code: str) -> None:
    """A new participant of a study. Raises NotFoundError, ConflictError."""
    taken = ConflictError(f"Study {study_code!r} already has a participant {code!r}.", code="participant_exists")
    with _unless_taken(taken), database.write() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError(f"There is no study {study_code!r}.")
        if people.find_participant(session, study.id, code) is not None:
            raise taken
        session.add(Participant(id=uuid.uuid4(), study_id=study.id, code=code, created_at=datetime.now(UTC)))


def issue_enrolment_code(database: Database, *, study_code: str, participant_code: str) -> IssuedCode:
    """A one-time code for a participant's next device. Raises NotFoundError."""
    code, now = new_code(), datetime.now(UTC)
    with database.write() as session:
        study = people.find_study(session, study_code)
        participant = people.find_participant(session, study.id, participant_code) if study else None
        if participant is None:
            raise NotFoundError(f"There is no participant {participant_code!r} in a study {study_code!r}.")
        session.add(
            Enrolment(
                id=uuid.uuid4(),
                participant_id=participant.id,
                code_sha256=sha256_hex(code),
                expires_at=now + ENROLMENT_VALID,
                created_at=now,
            )
        )
    return IssuedCode(code=code, expires_at=now + ENROLMENT_VALID)


def enrol_device(database: Database, *, code: str, device_name: str) -> IssuedDevice:
    """Exchange a code for a device's token, once. Raises NotFoundError for a code unknown, used or expired alike."""
    token, now = new_token(), datetime.now(UTC)
    with database.write() as session:
        enrolment = people.take_enrolment(session, sha256_hex(code), now)
        if enrolment is None:
            raise NotFoundError(
                "This enrolment code is unknown, used or expired. Ask the study for a new one.",
                code="enrolment_code_invalid",
            )
        participant = session.get_one(Participant, enrolment.participant_id)
        study = session.get_one(Study, participant.study_id)
        device = Device(id=uuid.uuid4(), participant_id=participant.id, name=device_name, enrolled_at=now)
        session.add(device)
        session.flush()
        session.add(
            AccessToken(
                id=uuid.uuid4(), token_sha256=sha256_hex(token), kind="device", device_id=device.id, created_at=now
            )
        )
    return IssuedDevice(
        token=token,
        device_id=device.id,
        participant_code=participant.code,
        study_code=study.code,
        marker=study.marker,
    )


@contextmanager
def _unless_taken(taken: ConflictError) -> Iterator[None]:
    """Of two that make the same at the same time the constraint lets one through; the other hears that it is taken."""
    try:
        yield
    except IntegrityError as error:
        raise taken from error
