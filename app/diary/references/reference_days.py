"""Read reference days from CSV, and replace a study's by them.

The columns are named as in the export of days: `participant`, `local_date`, and any of the headline
components. An empty cell is not known.
"""

import csv
import io
import math
import uuid
from collections.abc import Mapping
from datetime import date

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
NEEDED = {PARTICIPANT, LOCAL_DATE}


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
        rows = csv.DictReader(io.StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
        _check_columns(rows.fieldnames or [])
        for row in rows:
            cells = _Cells(rows.line_num, row)
            key = (cells.local_date(), cells.participant(participants))
            if key in days:
                raise cells.error(LOCAL_DATE, "stands twice", code="reference_day_repeated")
            days[key] = cells.amounts()
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInputError(
            f"This is no CSV in UTF-8: {error}", code="csv_unreadable"
        ) from None
    return days


def _check_columns(names: list[str]) -> None:
    wrong = NEEDED.symmetric_difference(names).difference(HEADLINE_COLUMNS)
    repeated = {name for name in names if names.count(name) > 1}
    for name in sorted(wrong | repeated):
        raise InvalidInputError(
            f"The columns are participant, local_date and any of {', '.join(HEADLINE_COLUMNS)}, each"
            f" once: see {name!r}.",
            code="reference_column_wrong",
            line=1,
            column=name,
        )


class _Cells:
    """A row's cells. A short row lacks cells (None); more than there are columns are under None."""

    def __init__(self, line: int, row: dict[str, str]) -> None:
        self._line = line
        self._texts = {name: (text or "").strip() for name, text in row.items() if name is not None}
        if len(self._texts) < len(row):
            raise self.error("", "has more cells than there are columns", code="csv_unreadable")

    def error(self, column: str, why: str, *, code: str) -> InvalidInputError:
        text = self._texts.get(column, "")
        return InvalidInputError(
            f"Line {self._line}: {column} {text[:40]!r} {why}.",
            code=code,
            line=self._line,
            column=column,
        )

    def participant(self, participants: Mapping[str, uuid.UUID]) -> uuid.UUID:
        try:
            return participants[self._texts[PARTICIPANT]]
        except KeyError:
            raise self.error(
                PARTICIPANT, "is not in the study", code="reference_participant_unknown"
            ) from None

    def local_date(self) -> date:
        try:
            return date.fromisoformat(self._texts[LOCAL_DATE])
        except ValueError:
            raise self.error(
                LOCAL_DATE, "is no day such as 2026-11-30", code="reference_date_invalid"
            ) from None

    def amounts(self) -> dict[str, float]:
        return {
            name: self._amount(name, text)
            for name, text in self._texts.items()
            if text and name not in NEEDED
        }

    def _amount(self, column: str, text: str) -> float:
        try:
            amount = float(text)
        except ValueError:
            amount = math.nan
        if 0 <= amount < math.inf:
            return amount
        raise self.error(column, "is no amount such as 4.6", code="reference_amount_invalid")
