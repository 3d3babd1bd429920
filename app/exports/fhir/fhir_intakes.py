"""Records for FHIR: searched by person and date, read by id, and the person whom they are of, by code alone."""

import uuid
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.core.errors import GoneError, MalformedRequestError, NotFoundError
from app.db.session import Database
from app.exports.fhir import queries as fhir_intakes
from app.exports.fhir.queries import IntakeFilter, IntakeRow
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.people import queries as people
from app.people.access.caller import Caller, DeviceCaller, require_study, visible_studies
from app.people.models import Participant, Study


@dataclass(frozen=True, slots=True)
class PersonName:
    """A participant by code. study_code None: in whichever study that the caller may see."""

    study_code: str | None
    code: str


@dataclass(frozen=True, slots=True)
class IntakeSearch:
    """What is asked for. people: one of each group."""

    people: tuple[tuple[PersonName, ...], ...]
    chosen: IntakeFilter


def search_intakes(
    database: Database, caller: Caller, asked: IntakeSearch, *, cursor: str | None, limit: int
) -> Page[IntakeRow]:
    """One page in the order of capture.

    Raises MalformedRequestError (`patient_ambiguous`), InvalidInputError for a cursor that is broken or of other
    filters.
    """
    listed = (
        f"intakes {replace(asked, chosen=replace(asked.chosen, item_ids=None))} {sorted(asked.chosen.item_ids or ())}"
    )
    after = decode_cursor(listed, cursor, INSTANT, ID)
    studies = visible_studies(caller)
    with database.read() as session:
        participants = _participants(session, caller, asked, studies)
        chosen = replace(asked.chosen, study_ids=studies, participant_ids=participants)
        rows = fhir_intakes.page_of_intakes(session, chosen, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.of.record.captured_at, row.of.record.item_id))


def read_intake(database: Database, caller: Caller, item_id: uuid.UUID) -> IntakeRow:
    """One record. Raises NotFoundError, GoneError (`record_rejected`: somebody said that it is no food)."""
    with database.read() as session:
        row = fhir_intakes.find_intake(session, item_id)
    if row is None or (isinstance(caller, DeviceCaller) and row.of.record.participant_id != caller.participant_id):
        raise NotFoundError("There is no such NutritionIntake.")
    require_study(caller, row.of.record.study_id, "NutritionIntake")
    if row.of.record.status == "rejected":
        raise GoneError("The record was rejected: nobody ate this.", code="record_rejected")
    return row


def read_person(database: Database, caller: Caller, name: PersonName) -> tuple[Participant, str]:
    """A participant and their study's code. Raises NotFoundError."""
    with database.read() as session:
        found = _people_of(session, name, visible_studies(caller))
        if isinstance(caller, DeviceCaller):
            found &= {caller.participant_id}
        if not found:
            raise NotFoundError("There is no such Patient.")
        participant = session.get_one(Participant, found.pop())
        return participant, session.get_one(Study, participant.study_id).code


def _participants(
    session: Session, caller: Caller, asked: IntakeSearch, studies: frozenset[uuid.UUID] | None
) -> frozenset[uuid.UUID] | None:
    """Whose records: of all groups that are asked for at once, and of a phone its participant's; None: anybody's."""
    groups = [{person for name in group for person in _people_of(session, name, studies)} for group in asked.people]
    if isinstance(caller, DeviceCaller):
        groups.append({caller.participant_id})
    return frozenset(set.intersection(*groups)) if groups else None


def _people_of(session: Session, name: PersonName, studies: frozenset[uuid.UUID] | None) -> set[uuid.UUID]:
    """The participant of this name among those whom the caller may see; nobody, or one."""
    if name.study_code is not None:
        study = people.find_study(session, name.study_code)
        if study is None or (studies is not None and study.id not in studies):
            return set()
        studies = frozenset({study.id})
    found = fhir_intakes.people_called(session, name.code, studies)
    if len(found) > 1:
        raise MalformedRequestError(
            f"Several studies have a participant {name.code!r}: name the study too, as Patient/STUDY.CODE.",
            code="patient_ambiguous",
        )
    return set(found)
