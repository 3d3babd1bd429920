"""The table of participants: a row a person, with the profile as anybody with a role in the study may read it."""

from collections.abc import Iterator, Mapping
from datetime import date, datetime
from typing import cast

from sqlalchemy.orm import Session

from app.exports.export_spec import ExportSpec
from app.exports.tables.export_table import Table
from app.exports.tables.participant_queries import ExportedParticipant, batches_of_participants
from app.http.tables.columns import Batch, Cell, PartOfBatch, Row, instant_text
from app.http.tables.participant_columns import PARTICIPANT_PART
from app.meals.queries import first_days
from app.people.access.caller import Caller, visible_rows
from app.people.profiles import PROFILE_KEYS


def participant_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """By study and code, with those who have left and whose rows are kept."""

    def batches() -> Iterator[Batch]:
        for people in batches_of_participants(session, visible_rows(caller, spec.filters)):
            days = first_days(session, [exported.person.id for exported in people])
            rows = [_row(exported, days.get(exported.person.id)) for exported in people]
            yield [PartOfBatch(PARTICIPANT_PART, rows)]

    return Table((PARTICIPANT_PART,), batches())


def _row(exported: ExportedParticipant, first_day: date | None) -> Row:
    person = exported.person
    profile, since = person.profile or {}, first_day or exported.enrolled_at
    birth_year = profile.get("birth_year")
    age = since.year - birth_year if since is not None and birth_year is not None else None
    values = cast("Mapping[str, Cell]", {**profile, "birth_year": age})  # the age has the place of the year
    return (
        exported.study_code,
        person.code,
        *(values.get(name) for name in PROFILE_KEYS),
        _text(person.starts_on),
        _text(exported.enrolled_at),
        _text(person.withdrawn_at),
        exported.meals,
        _text(exported.first_meal_on),
        _text(exported.last_meal_on),
    )


def _text(when: date | None) -> str | None:
    if isinstance(when, datetime):
        return instant_text(when)
    return None if when is None else when.isoformat()
