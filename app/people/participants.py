"""Participants of a study, by pseudonymous code: made, listed, their profile kept up to date."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from app.db.session import Database, unless_taken
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.nutrition.intakes.energy_requirement import Person
from app.nutrition.intakes.life_stage import MAX_AGE_YEARS, PREGNANCY_YEARS
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, Study
from app.people.privacy_queries import join_participant
from app.people.spent_codes import is_code_spent
from app.people.studies import known_study

PROFILE_KEYS = (
    "sex",
    "birth_year",
    "height_cm",
    "weight_kg",
    "activity",
    "is_pregnant",
    "trimester",
    "is_lactating",
    "lactation_months",
)


@dataclass(frozen=True, slots=True)
class ParticipantChange:
    """profile: keys of PROFILE_KEYS, None takes one away. moves_start: whether starts_on is to be set."""

    profile: Mapping[str, Any]
    moves_start: bool = False
    starts_on: date | None = None


def create_participant(
    database: Database,
    box: SecretBox,
    *,
    study_code: str,
    code: str,
    caller: Caller | None = None,
    change: ParticipantChange | None = None,
) -> Participant:
    """A new participant of a study. Raises NotFoundError, ConflictError, InvalidInputError."""
    taken = ConflictError(f"Study {study_code!r} already has a participant {code!r}.", code="participant_exists")
    with unless_taken(taken), database.write() as session:
        study = known_study(people.find_study(session, study_code))
        if people.find_participant(session, study.id, code) is not None:
            raise taken
        if is_code_spent(session, box, study.id, code):  # after the row: whoever erases it spends the code with it
            raise ConflictError(
                f"The code {code!r} was a participant's who has left study {study_code!r}: take another.",
                code="participant_code_spent",
            )
        participant = Participant(
            id=uuid.uuid4(), study_id=study.id, code=code, alias=uuid.uuid4(), created_at=datetime.now(UTC)
        )
        fields = _apply(participant, change or ParticipantChange({}))
        session.add(participant)
        note(session, caller, "participant.create", study_id=study.id, subject=participant.alias, fields=fields)
    return participant


def list_participants(database: Database, study_code: str, *, cursor: str | None, limit: int) -> Page[Participant]:
    """The study's participants by code, the withdrawn ones too as far as they are kept."""
    listed = f"participants of {study_code}"
    after = decode_cursor(listed, cursor, TEXT)
    with database.read() as session:
        study = known_study(people.find_study(session, study_code))
        rows = people.page_of_participants(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda participant: participant.code)


def read_participant(database: Database, study_code: str, code: str) -> Participant:
    """One participant. Raises NotFoundError."""
    with database.read() as session:
        return require_participant(session, study_code, code)[1]


def change_participant(
    database: Database, caller: StaffCaller, study_code: str, code: str, change: ParticipantChange
) -> Participant:
    """Change profile and first day: what is named only.

    Raises NotFoundError, InvalidInputError, ConflictError (`participant_withdrawn`).
    """
    with database.write() as session:
        study, participant = require_participant(session, study_code, code, lock=True)
        if participant.withdrawn_at is not None:
            raise ConflictError("This participant has left the study.", code="participant_withdrawn")
        fields = _apply(participant, change)
        if fields:
            note(session, caller, "participant.change", study_id=study.id, subject=participant.alias, fields=fields)
        return participant


def require_participant(
    session: Session, study_code: str, code: str, *, lock: bool = False
) -> tuple[Study, Participant]:
    """A study's participant by code. Raises NotFoundError."""
    study = people.find_study(session, study_code)
    participant = people.find_participant(session, study.id, code, lock=lock) if study else None
    if study is None or participant is None:
        raise NotFoundError(f"There is no participant {code!r} in a study {study_code!r}.")
    return study, participant


def _apply(participant: Participant, change: ParticipantChange) -> list[str]:
    """Set what is named; which fields differ now."""
    before = participant.profile or {}
    profile = {key: value for key, value in {**before, **change.profile}.items() if value is not None}
    _check(profile, datetime.now(UTC).year)
    fields = sorted(key for key in PROFILE_KEYS if before.get(key) != profile.get(key))
    if fields:
        participant.profile = profile or None
    if change.moves_start and participant.starts_on != change.starts_on:
        participant.starts_on = change.starts_on
        fields.append("starts_on")
    return fields


def _check(profile: Mapping[str, Any], this_year: int) -> None:
    """Refuse a profile that contradicts itself: Person is what reference intakes are read for.

    A birth year leaves two ages; the profile stands if it can be at one of them.
    """
    birth_year = profile.get("birth_year")
    ages = [float(PREGNANCY_YEARS[0])]
    if birth_year is not None:
        oldest = this_year - birth_year
        if not 0 <= oldest <= MAX_AGE_YEARS:
            raise InvalidInputError(f"Nobody who is alive was born in {birth_year}.", code="profile_impossible")
        ages = [float(oldest), max(0.0, oldest - 1.0)]
    errors = [error for error in (_contradiction(profile, age) for age in ages) if error]
    if len(errors) == len(ages):
        raise InvalidInputError(f"{errors[0][:1].upper()}{errors[0][1:]}.", code="profile_impossible")


def _contradiction(profile: Mapping[str, Any], age_years: float) -> str | None:
    height_cm = profile.get("height_cm")
    try:
        Person(
            age_years=age_years,
            sex=profile.get("sex"),
            weight_kg=profile.get("weight_kg"),
            height_m=height_cm / 100.0 if height_cm is not None else None,
            activity=profile.get("activity"),
            is_pregnant=profile.get("is_pregnant", False),
            trimester=profile.get("trimester"),
            is_lactating=profile.get("is_lactating", False),
            lactation_months=profile.get("lactation_months"),
        )
    except ValueError as error:
        return str(error)
    return None


def require_in_study(session: Session, participant_id: uuid.UUID) -> Participant:
    """Before something is added to a participant: they are here, and until commit they stay. Raises GoneError."""
    participant = join_participant(session, participant_id)
    if participant is None or participant.withdrawn_at is not None:
        raise has_left()
    return participant


def has_left() -> GoneError:
    """What a phone hears whose participant has left."""
    return GoneError("This participant has left the study.", code="withdrawn")
