"""Lists of days and of mean intakes for researchers; the means leave out open days and count them."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from statistics import fmean
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.session import Database
from app.diary import queries as days
from app.diary.day_definition import Amount, DaysOf, within
from app.diary.queries import DayRow, read_days
from app.diary.study_days import judge_days
from app.http.paging import DAY, ID, TEXT, Page, decode_cursor, list_name, page_of
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import Meal
from app.nutrition.components import HEADLINE_COLUMNS
from app.nutrition.plausible import Plausibility
from app.people.access.caller import Caller, visible_rows
from app.people.models import Participant, Study
from app.people.profiles import Profile
from app.people.studies import enter_study


class MeanAmount(NamedTuple):
    """A mean daily amount over closed days, the number of them on which it is known, and their mean coverage.

    mean: None if it is known on no closed day
    coverage: None if it is unknown on one of the closed days
    """

    mean: float | None
    days: int
    coverage: float | None


@dataclass(frozen=True)
class IntakeRow:
    """A participant's mean daily intake over closed days.

    first_day, last_day: of all days with a meal or a diary entry; days: their number
    whole_days: closed days that are measured and final, with all energy known; whole_energy_kcal:
        their mean energy
    """

    participant: str
    profile: Profile | None
    first_day: date
    last_day: date
    days: int
    closed_days: int
    unmeasured_meals: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    whole_days: int
    whole_energy_kcal: float | None
    components: Mapping[str, MeanAmount]

    @property
    def open_days(self) -> int:
        """The number of days that are not closed, which the means leave out."""
        return self.days - self.closed_days

    @property
    def silent_days(self) -> int:
        """The number of days between the first and the last without a meal or a diary entry."""
        return (self.last_day - self.first_day).days + 1 - self.days


def page_of_intakes(
    session: Session,
    study: Study,
    *,
    first_day: date | None,
    last_day: date | None,
    after: str | None,
    limit: int,
) -> list[IntakeRow]:
    """Return mean intakes of at most `limit` participants who have a day, by code, after the code `after`."""
    participant_ids = _page_of_participants(session, study.id, first_day, last_day, after, limit)
    if not participant_ids:
        return []

    days_of: dict[uuid.UUID, list[DayRow]] = {
        participant_id: [] for participant_id in participant_ids
    }
    for day in read_days(session, DaysOf(participant_ids, first_day, last_day)):
        days_of[day.participant_id].append(day)
    return [_intake(days) for days in days_of.values()]


def _intake(days: Sequence[DayRow]) -> IntakeRow:
    """The means over a participant's days, which are in order."""
    closed = [day for day in days if day.is_closed]
    whole_kcal = [day.whole_amount("energy_kcal") for day in closed]
    known_kcal = [amount for amount in whole_kcal if amount is not None]
    return IntakeRow(
        participant=days[0].participant_code,
        profile=days[0].profile,
        first_day=days[0].local_date,
        last_day=days[-1].local_date,
        days=len(days),
        closed_days=len(closed),
        unmeasured_meals=sum(day.unmeasured_meals for day in closed),
        unmeasured_items=sum(day.unmeasured_items for day in closed),
        provisional_items=sum(day.provisional_items for day in closed),
        leftovers_unknown_items=sum(day.leftovers_unknown_items for day in closed),
        whole_days=len(known_kcal),
        whole_energy_kcal=fmean(known_kcal) if known_kcal else None,
        components={name: _mean([day.amount(name) for day in closed]) for name in HEADLINE_COLUMNS},
    )


def _mean(amounts: Sequence[Amount]) -> MeanAmount:
    values = [amount.value for amount in amounts if amount.value is not None]
    coverages = [amount.coverage for amount in amounts if amount.coverage is not None]
    is_covered = len(coverages) == len(amounts) > 0
    return MeanAmount(
        mean=fmean(values) if values else None,
        days=len(values),
        coverage=fmean(coverages) if is_covered else None,
    )


def _page_of_participants(
    session: Session,
    study_id: uuid.UUID,
    first_day: date | None,
    last_day: date | None,
    after: str | None,
    limit: int,
) -> list[uuid.UUID]:
    """Return the first participants after a code who have a day with a meal or a diary entry."""
    has_day = sa.or_(
        *(
            sa.exists().where(
                table.participant_id == Participant.id,
                *within(table.local_date, first_day, last_day),
            )
            for table in (Meal, DiaryDay)
        )
    )
    query = sa.select(Participant.id).where(Participant.study_id == study_id, has_day)
    if after is not None:
        query = query.where(Participant.code > after)
    return list(session.scalars(query.order_by(Participant.code).limit(limit)))


@dataclass(frozen=True)
class Intake(IntakeRow):
    """A participant's mean intake and the plausibility of its energy."""

    plausibility: Plausibility


def list_day_summaries(
    database: Database, caller: Caller, chosen: RowFilter, *, cursor: str | None, limit: int
) -> Page[DayRow]:
    """Return a page of days by (local date, participant).

    Raises InvalidInputError for an invalid cursor.
    """
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
    """Return mean daily intakes of a study's participants, by code.

    Raises NotFoundError, InvalidInputError.
    """
    name = f"intakes of {study_code} from {first_day} to {last_day}"
    after = decode_cursor(name, cursor, TEXT)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = page_of_intakes(
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
