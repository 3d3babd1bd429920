"""Read reference days from CSV, and replace a study's by them.

The columns are named as in the export of days: `participant`, `local_date`, and any of the headline
components. An empty cell is not known.
"""

import csv
import io
import math
import uuid
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from functools import partial
from typing import TypeVar

import sqlalchemy as sa

from app.core.errors import InvalidInputError
from app.db.session import Database
from app.diary.day_definition import DayKey
from app.diary.references.models import ReferenceDay
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.models import Participant
from app.people.studies import load_study

PARTICIPANT, LOCAL_DATE = "participant", "local_date"
WHY = {
    "reference_date_invalid": "is no day such as 2026-11-30",
    "reference_participant_unknown": "is no participant of the study",
    "reference_day_repeated": "the participant already has above",
    "reference_amount_invalid": "is no amount such as 4.6",
}
Row = Mapping[str, str]
T = TypeVar("T")


def replace_reference(
    database: Database, caller: StaffCaller, study_code: str, content: bytes
) -> int:
    """Replace all reference days of a study; return their number.

    Raises NotFoundError, and what read_reference does: then nothing has changed.
    """
    with database.write() as session:
        study = load_study(session, study_code)
        # locked against an erasure, and another upload
        query = sa.select(Participant).where(Participant.study_id == study.id)
        query = query.order_by(Participant.id).with_for_update(key_share=True)
        participants = {person.code: person.id for person in session.scalars(query)}
        days = read_reference(content, participants)
        of_study = sa.select(Participant.id).where(Participant.study_id == study.id)
        session.execute(sa.delete(ReferenceDay).where(ReferenceDay.participant_id.in_(of_study)))
        for (local_date, participant_id), amounts in days.items():
            session.add(
                ReferenceDay(participant_id=participant_id, local_date=local_date, amounts=amounts)
            )
        audit.note(session, caller, "reference.put", study_id=study.id, days=len(days))
    return len(days)


def read_reference(
    content: bytes, participants: Mapping[str, uuid.UUID]
) -> dict[DayKey, dict[str, float]]:
    """Return the amounts of each day. participants: id by code.

    Raises InvalidInputError with `line` and `column` of the first error: `csv_unreadable`,
    `reference_column_wrong`, `reference_participant_unknown`, `reference_date_invalid`,
    `reference_amount_invalid`, `reference_day_repeated`.
    """
    days: dict[DayKey, dict[str, float]] = {}
    try:
        text = io.StringIO(content.decode("utf-8-sig"), newline="")
        rows = csv.DictReader(text, restval="", strict=True)
        columns = _amount_columns(rows.fieldnames or [])
        for row in rows:
            if None in row:
                raise csv.Error(f"line {rows.line_num} has more cells than the first")  # noqa: TRY301
            read = partial(_read, rows.line_num, row)
            local_date = read(LOCAL_DATE, date.fromisoformat, code="reference_date_invalid")
            participant = read(
                PARTICIPANT, participants.__getitem__, code="reference_participant_unknown"
            )
            key = (local_date, participant)
            if key in days:
                raise _error(rows.line_num, row, LOCAL_DATE, code="reference_day_repeated")
            days[key] = {
                column: read(column, _amount, code="reference_amount_invalid")
                for column in columns
                if row[column]
            }
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInputError(f"No CSV in UTF-8: {error}.", code="csv_unreadable") from None
    return days


def _amount_columns(names: Sequence[str]) -> list[str]:
    offered = {PARTICIPANT, LOCAL_DATE, *HEADLINE_COLUMNS}
    for name in (PARTICIPANT, LOCAL_DATE, *names):
        if name not in offered or names.count(name) != 1:
            raise InvalidInputError(
                f"Column {name!r} is wrong, missing or repeated: the columns are participant,"
                f" local_date and any of {', '.join(HEADLINE_COLUMNS)}.",
                code="reference_column_wrong",
                column=name,
            )
    return [name for name in names if name in HEADLINE_COLUMNS]


def _read(line: int, row: Row, column: str, reader: Callable[[str], T], *, code: str) -> T:
    try:
        return reader(row[column].strip())
    except (KeyError, ValueError):
        raise _error(line, row, column, code=code) from None


def _error(line: int, row: Row, column: str, *, code: str) -> InvalidInputError:
    message = f"Line {line}: {column} is {row[column][:40]!r}, which {WHY[code]}."
    return InvalidInputError(message, code=code, line=line, column=column)


def _amount(text: str) -> float:
    amount = float(text)
    if not 0 <= amount < math.inf:
        raise ValueError
    return amount
