"""Create, list and change a study's participants, who are known by a pseudonymous code only."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import cast

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from app.db.session import Database, unless_taken
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.nutrition.intakes.life_stage import MAX_AGE_YEARS, PREGNANCY_YEARS
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, Study
from app.people.privacy_queries import join_participant
from app.people.profiles import PROFILE_KEYS, Profile, person_at_age
from app.people.studies import load_study
from app.people.tombstones import is_code_spent

COLUMNS = ("starts_on", "arm", "visit", "excluded")  # that staff set


@dataclass(frozen=True, slots=True)
class ParticipantChange:
    """A change of a participant. profile: checked values by PROFILE_KEYS; None removes a key.

    columns: new values by COLUMNS.
    """

    profile: Mapping[str, object]
    columns: Mapping[str, object] = field(default_factory=dict)


def create_participant(
    database: Database,
    box: SecretBox,
    *,
    study_code: str,
    code: str,
    caller: Caller | None = None,
    change: ParticipantChange | None = None,
) -> Participant:
    """Create a participant of a study. Raises NotFoundError, ConflictError, InvalidInputError."""
    conflict = ConflictError(
        f"Study {study_code!r} already has a participant {code!r}.", code="participant_exists"
    )
    with unless_taken(conflict), database.write() as session:
        study = load_study(session, study_code)
        if people.find_participant(session, study.id, code) is not None:
            raise conflict
        # after looking for the row: an erasure of it spends the code
        if is_code_spent(session, box, study.id, code):
            raise ConflictError(
                f"The code {code!r} belonged to a participant who has left study {study_code!r}: use another code.",
                code="participant_code_spent",
            )
        participant = Participant(
            id=uuid.uuid4(),
            study_id=study.id,
            code=code,
            alias=uuid.uuid4(),
            created_at=datetime.now(UTC),
        )
        fields = _apply(participant, change or ParticipantChange({}))
        session.add(participant)
        note(
            session,
            caller,
            "participant.create",
            study_id=study.id,
            subject=participant.alias,
            fields=fields,
        )
    return participant


def list_participants(
    database: Database, study_code: str, *, cursor: str | None, limit: int
) -> Page[Participant]:
    """Return a page of a study's participants by code, with those who have left and whose rows are kept."""
    list_name = f"participants of {study_code}"
    after = decode_cursor(list_name, cursor, TEXT)
    with database.read() as session:
        study = load_study(session, study_code)
        rows = people.page_of_participants(session, study.id, after=after, limit=limit + 1)
    return page_of(list_name, rows, limit, lambda participant: participant.code)


def read_participant(database: Database, study_code: str, code: str) -> Participant:
    """Return a participant. Raises NotFoundError."""
    with database.read() as session:
        return require_participant(session, study_code, code)[1]


def change_participant(
    database: Database, caller: StaffCaller, study_code: str, code: str, change: ParticipantChange
) -> Participant:
    """Change a participant's profile and COLUMNS.

    Raises NotFoundError, InvalidInputError, ConflictError (`participant_withdrawn`).
    """
    with database.write() as session:
        study, participant = require_participant(session, study_code, code, lock=True)
        if participant.withdrawn_at is not None:
            raise ConflictError(
                "This participant has left the study.", code="participant_withdrawn"
            )
        fields = _apply(participant, change)
        if fields:
            note(
                session,
                caller,
                "participant.change",
                study_id=study.id,
                subject=participant.alias,
                fields=fields,
            )
        return participant


def require_participant(
    session: Session, study_code: str, code: str, *, lock: bool = False
) -> tuple[Study, Participant]:
    """Return a study and its participant by code. Raises NotFoundError."""
    study = people.find_study(session, study_code)
    participant = people.find_participant(session, study.id, code, lock=lock) if study else None
    if study is None or participant is None:
        raise NotFoundError(f"There is no participant {code!r} in a study {study_code!r}.")
    return study, participant


def _apply(participant: Participant, change: ParticipantChange) -> list[str]:
    """Set the changed fields. Returns their names."""
    before = participant.profile or {}
    merged = {**before, **change.profile}
    profile = cast("Profile", {key: value for key, value in merged.items() if value is not None})
    _check_profile(profile, datetime.now(UTC).year)
    fields = sorted(key for key in PROFILE_KEYS if before.get(key) != profile.get(key))
    if fields:
        participant.profile = profile or None
    for name, value in change.columns.items():
        if getattr(participant, name) != value:
            setattr(participant, name, value)
            fields.append(name)
    return fields


def _check_profile(profile: Profile, current_year: int) -> None:
    """Refuse a profile that contradicts itself. Raises InvalidInputError (`profile_impossible`).

    A birth year allows two ages; the profile is valid if it is consistent at one of them.
    """
    birth_year = profile.get("birth_year")
    ages = [float(PREGNANCY_YEARS[0])]
    if birth_year is not None:
        oldest = current_year - birth_year
        if not 0 <= oldest <= MAX_AGE_YEARS:
            raise InvalidInputError(
                f"Nobody who is alive was born in {birth_year}.", code="profile_impossible"
            )
        ages = [float(oldest), max(0.0, oldest - 1.0)]
    errors = []
    for age in ages:
        try:
            person_at_age(profile, age)
        except ValueError as error:
            errors.append(str(error))
    if len(errors) == len(ages):
        raise InvalidInputError(
            f"{errors[0][:1].upper()}{errors[0][1:]}.", code="profile_impossible"
        )


def require_in_study(session: Session, participant_id: uuid.UUID) -> Participant:
    """Return a participant who is in the study, locked against withdrawal until commit.

    Raises GoneError.
    """
    participant = join_participant(session, participant_id)
    if participant is None or participant.withdrawn_at is not None:
        raise withdrawn_error()
    return participant


def withdrawn_error() -> GoneError:
    """Return the error for a phone whose participant has left the study."""
    return GoneError("This participant has left the study.", code="withdrawn")
