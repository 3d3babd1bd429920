"""Lists of days and of mean intakes for researchers; the means leave out open days and count them."""

from dataclasses import dataclass
from datetime import date

from app.db.session import Database
from app.diary import intake_queries as intakes
from app.diary import queries as days
from app.diary.intake_queries import IntakeRow
from app.diary.queries import DayRow
from app.diary.study_days import judge_days
from app.http.paging import DAY, ID, TEXT, Page, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.nutrition.plausible_energy import Plausibility
from app.people.access.caller import Caller, visible_rows
from app.people.studies import enter_study


@dataclass(frozen=True)
class Intake(IntakeRow):
    """A participant's mean intake and the plausibility of its energy."""

    plausibility: Plausibility


def list_day_summaries(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[DayRow]:
    """Return a page of days by (local date, participant). Raises InvalidInputError for an invalid cursor."""
    chosen = visible_rows(caller, chosen)
    name = list_name("days", chosen)
    after = decode_cursor(name, cursor, DAY, ID)
    with database.read() as session:
        rows = days.page_of_days(session, chosen, after=after, limit=limit + 1)
    return page_of(name, rows, limit, lambda row: (row.local_date, row.participant_id))


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
    """Return mean daily intakes of a study's participants, by code. Raises NotFoundError, InvalidInputError."""
    name = f"intakes of {study_code} from {first_day} to {last_day}"
    after = decode_cursor(name, cursor, TEXT)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = intakes.page_of_intakes(
            session, study, first_day=first_day, last_day=last_day, after=after, limit=limit + 1
        )
    page = page_of(name, rows, limit, lambda row: (row.participant,))
    judged = [
        Intake(
            **vars(row),
            plausibility=judge_days(
                row.profile, row.last_day, row.whole_energy_kcal, row.whole_days
            ),
        )
        for row in page.rows
    ]
    return Page(judged, page.cursor)
