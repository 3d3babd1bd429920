"""Records for FHIR: search by participant and date, reading by id, and participants by code."""

import uuid
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.core.errors import GoneError, MalformedRequestError, NotFoundError
from app.db.session import Database
from app.extras.fhir import queries as fhir_intakes
from app.extras.fhir.queries import IntakeFilter, IntakeRow
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.people import queries as people
from app.people.access.caller import Caller, DeviceCaller, require_study, visible_studies
from app.people.models import Participant, Study
from app.records.page_queries import studies_of


@dataclass(frozen=True, slots=True)
class PersonName:
    """A participant by code. study_code None: in any study that the caller may see."""

    study_code: str | None
    code: str


@dataclass(frozen=True, slots=True)
class IntakeSearch:
    """A search. people: a record's participant must be in every group."""

    people: tuple[tuple[PersonName, ...], ...]
    chosen: IntakeFilter


def search_intakes(
    database: Database, caller: Caller, search: IntakeSearch, *, cursor: str | None, limit: int
) -> Page[IntakeRow]:
    """Return a page in the order of capture.

    Raises MalformedRequestError (`patient_ambiguous`), InvalidInputError for a cursor that is broken or of other
    filters.
    """
    without_ids = replace(search, chosen=replace(search.chosen, item_ids=None))
    listed = f"intakes {without_ids} {sorted(search.chosen.item_ids or ())}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    studies = visible_studies(caller)
    with database.read() as session:
        participants = _participants(session, caller, search, studies)
        if participants is None:
            in_search = studies_of(session, None, studies)
            studies = None if in_search is None else frozenset(in_search)
        chosen = replace(search.chosen, study_ids=studies, participant_ids=participants)
        rows = fhir_intakes.page_of_intakes(session, chosen, after=after, limit=limit + 1)
    return page_of(
        listed,
        rows,
        limit,
        lambda intake: (intake.row.record.captured_at, intake.row.record.item_id),
    )


def read_intake(database: Database, caller: Caller, item_id: uuid.UUID) -> IntakeRow:
    """Return a record. Raises NotFoundError, GoneError (`record_rejected`)."""
    with database.read() as session:
        intake = fhir_intakes.find_intake(session, item_id)
    if intake is None:
        raise NotFoundError("There is no such NutritionIntake.")
    record = intake.row.record
    if isinstance(caller, DeviceCaller) and record.participant_id != caller.participant_id:
        raise NotFoundError("There is no such NutritionIntake.")
    require_study(caller, record.study_id, "NutritionIntake")
    if record.status == "rejected":
        raise GoneError("The record was rejected: nobody ate this.", code="record_rejected")
    return intake


def read_person(database: Database, caller: Caller, name: PersonName) -> tuple[Participant, str]:
    """Return a participant and the study's code. Raises NotFoundError."""
    with database.read() as session:
        ids = _participant_ids(session, name, visible_studies(caller))
        if isinstance(caller, DeviceCaller):
            ids &= {caller.participant_id}
        if not ids:
            raise NotFoundError("There is no such Patient.")
        participant = session.get_one(Participant, ids.pop())
        return participant, session.get_one(Study, participant.study_id).code


def _participants(
    session: Session, caller: Caller, search: IntakeSearch, studies: frozenset[uuid.UUID] | None
) -> frozenset[uuid.UUID] | None:
    """Return the participants in all groups of the search, for a phone only its own; None: no restriction."""
    groups = [
        {id_ for name in group for id_ in _participant_ids(session, name, studies)}
        for group in search.people
    ]
    if isinstance(caller, DeviceCaller):
        groups.append({caller.participant_id})
    return frozenset(set.intersection(*groups)) if groups else None


def _participant_ids(
    session: Session, name: PersonName, studies: frozenset[uuid.UUID] | None
) -> set[uuid.UUID]:
    """Return the id of the participant of this name in the visible studies, or an empty set."""
    if name.study_code is not None:
        study = people.find_study(session, name.study_code)
        if study is None or (studies is not None and study.id not in studies):
            return set()
        studies = frozenset({study.id})
    ids = fhir_intakes.participants_by_code(session, name.code, studies)
    if len(ids) > 1:
        raise MalformedRequestError(
            f"Several studies have a participant {name.code!r}: name the study too, as Patient/STUDY.CODE.",
            code="patient_ambiguous",
        )
    return set(ids)
