"""Days for researchers: a row a participant-day, and mean intakes over closed days, open ones left out and counted."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import date

from sqlalchemy.orm import Session

from app.db.session import Database
from app.diary import intake_queries as intakes
from app.diary import queries as days
from app.diary.intake_queries import IntakeRow
from app.diary.queries import DayFilter
from app.diary.study_days import StudyDay, judge_days, number_days
from app.http.cursors import DAY, ID, TEXT, Page, decode_cursor, encode_cursor
from app.nutrition.plausible_energy import Plausibility
from app.people.access.caller import Caller, DeviceCaller, visible_studies
from app.people.studies import enter_study

STREAM_PAGE = 1000  # rows a query while streaming


@dataclass(frozen=True, slots=True)
class Intake:
    """A participant's mean intake; silent_days: between their first and last day, without a meal or a word."""

    row: IntakeRow
    silent_days: int
    plausibility: Plausibility


def list_day_summaries(
    database: Database, caller: Caller, chosen: DayFilter, *, cursor: str | None, limit: int
) -> Page[StudyDay]:
    """One page, by (local date, participant). Raises InvalidInputError for a cursor that is broken or of others."""
    listed = "days " + json.dumps(asdict(chosen), default=str, sort_keys=True)
    after = decode_cursor(listed, cursor, DAY, ID)
    with database.read() as session:
        rows = days.page_of_days(session, visible_days(caller, chosen), after=after, limit=limit + 1)
        numbered = number_days(session, rows[:limit])
    if len(rows) <= limit:
        return Page(numbered, None)
    last = rows[limit - 1]
    return Page(numbered, encode_cursor(listed, last.local_date, last.participant_id))


def all_day_summaries(session: Session, caller: Caller, chosen: DayFilter) -> Iterator[StudyDay]:
    """All days, a page's query at a time; memory stays that of a page. Of one moment: in the caller's transaction."""
    visible, after = visible_days(caller, chosen), None
    while True:
        rows = days.page_of_days(session, visible, after=after, limit=STREAM_PAGE)
        yield from number_days(session, rows)
        if len(rows) < STREAM_PAGE:
            return
        after = (rows[-1].local_date, rows[-1].participant_id)


def visible_days(caller: Caller, chosen: DayFilter) -> DayFilter:
    """Of these the ones that the caller may see: a phone its participant's only, staff those of their studies."""
    if isinstance(caller, DeviceCaller):
        return replace(chosen, participant_id=caller.participant_id)
    return replace(chosen, study_ids=visible_studies(caller))


def list_intakes(
    database: Database,
    caller: Caller,
    study_code: str,
    *,
    first_day: date | None,
    last_day: date | None,
    cursor: str | None,
    limit: int,
) -> Page[Intake]:
    """Mean daily intakes of a study's participants, by code. Raises NotFoundError, InvalidInputError."""
    listed = f"intakes of {study_code} from {first_day} to {last_day}"
    after = decode_cursor(listed, cursor, TEXT)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = intakes.page_of_intakes(
            session, study.id, first_day=first_day, last_day=last_day, after=after, limit=limit + 1
        )
    found = [
        Intake(
            row,
            (row.last_day - row.first_day).days + 1 - row.days,
            judge_days(row.profile, row.last_day, row.whole_energy_kcal, row.whole_days),
        )
        for row in rows[:limit]
    ]
    return Page(found, encode_cursor(listed, rows[limit - 1].participant_code) if len(rows) > limit else None)
