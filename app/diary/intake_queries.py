"""SQL of intakes: means over participants' closed days, and which days those are."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.day_definition import FULL
from app.diary.models import DayMark, DaySum, DiaryDay
from app.diary.queries import sums_of_days
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study


class MeanAmount(NamedTuple):
    """A mean daily amount over closed days, on how many of them it is known, and the mean of their coverages.

    value: None where it is known on no closed day. coverage: None where one of the days has none.
    """

    value: float | None
    days: int
    coverage: float | None


class ClosedDay(NamedTuple):
    """is_nothing: nothing was eaten. is_whole: nothing was, or the eaten grams of everything are known and final."""

    participant_id: uuid.UUID
    local_date: date
    is_nothing: bool
    is_whole: bool


@dataclass(frozen=True, slots=True)
class IntakeRow:
    """A participant's mean daily intake over closed days.

    open_days: days with a meal or a word that are not closed, left out. first_day, last_day: of all their days.
    days: with a meal or a word. whole_days: closed days of which everything is measured, final, and has an energy;
    whole_energy_kcal: their mean energy.
    """

    participant_id: uuid.UUID
    participant_code: str
    profile: dict[str, Any] | None
    first_day: date
    last_day: date
    days: int
    closed_days: int
    open_days: int
    unmeasured_meals: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    whole_days: int
    whole_energy_kcal: float | None
    means: Mapping[str, MeanAmount]


def page_of_intakes(
    session: Session,
    study_id: uuid.UUID,
    *,
    first_day: date | None,
    last_day: date | None,
    after: str | None,
    limit: int,
) -> list[IntakeRow]:
    """Mean intakes of at most `limit` participants who have a day, by code, those behind `after`."""
    people = _page_of_people(session, study_id, first_day, last_day, after, limit)
    if not people:
        return []

    def of_people(table: type[DaySum | DayMark]) -> list[Any]:
        return [table.participant_id.in_(people), *within(table.local_date, first_day, last_day)]

    expects_after_pair = session.scalar(sa.select(Study.expects_after_pair).where(Study.id == study_id))
    day = sums_of_days(session, of_people)
    is_closed, is_nothing = day.c.status == "closed", is_day_of_nothing(day)
    is_measured = sa.and_(is_measured_whole(day), day.c.energy_kcal_coverage >= FULL)
    closed_sums = [
        sa.func.coalesce(sa.func.sum(sa.case((is_closed, day.c[name]), else_=0)), 0).label(name)
        for name in ("unmeasured_meals", "unmeasured_items", "provisional_items", "unseen_leftovers_items")
    ]
    whole_kcal = sa.case((is_nothing, 0.0), (is_measured, day.c.energy_kcal))
    means: list[Any] = []
    for name in HEADLINE_COLUMNS:
        amount = sa.case((is_nothing, 0.0), (is_closed, day.c[name]))
        coverage = sa.case((is_nothing, 1.0), (is_closed, day.c[f"{name}_coverage"]))
        closed_days = sa.func.count(sa.case((is_closed, 1)))
        means += [
            sa.func.avg(amount).label(name),
            sa.func.count(amount).label(f"{name}_days"),
            sa.case((sa.func.count(coverage) == closed_days, sa.func.avg(coverage))).label(f"{name}_coverage"),
        ]
    query = sa.select(
        day.c.participant_id,
        sa.func.min(day.c.local_date).label("first_day"),
        sa.func.max(day.c.local_date).label("last_day"),
        sa.func.count().label("days"),
        sa.func.count(sa.case((is_closed, 1))).label("closed_days"),
        *closed_sums,
        sa.func.count(whole_kcal).label("whole_days"),
        sa.func.avg(whole_kcal).label("whole_kcal"),
        *means,
    ).group_by(day.c.participant_id)
    rows = {row["participant_id"]: row for row in session.execute(query).mappings()}
    return [
        _intake_row(rows[person.id], person, expects_after_pair=bool(expects_after_pair))
        for person in session.scalars(
            sa.select(Participant).where(Participant.id.in_(people)).order_by(Participant.code)
        )
    ]


def within(local_date: Any, first_day: date | None, last_day: date | None) -> list[sa.ColumnElement[bool]]:
    """The conditions of a range of local days, both included."""
    found = []
    if first_day is not None:
        found.append(local_date >= first_day)
    if last_day is not None:
        found.append(local_date <= last_day)
    return found


def is_day_of_nothing(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed and nothing was eaten; as DayRow.is_nothing."""
    is_empty = sa.and_(day.c.meals > 0, day.c["items"] == 0, day.c.unmeasured_meals == 0)
    return sa.and_(day.c.status == "closed", sa.or_(sa.and_(day.c.said_nothing, day.c.meals == 0), is_empty))


def is_measured_whole(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed, and the grams of all that was eaten are known and final; as DayRow.is_complete."""
    is_known = sa.and_(day.c.unmeasured_items == 0, day.c.unmeasured_meals == 0, day.c.provisional_items == 0)
    return sa.and_(day.c.status == "closed", day.c["items"] > 0, is_known)


def closed_days(
    session: Session, study_id: uuid.UUID, first_day: date | None, last_day: date | None
) -> list[ClosedDay]:
    """The closed days of a study."""

    def of_study(table: type[DaySum | DayMark]) -> list[Any]:
        return [table.study_id == study_id, *within(table.local_date, first_day, last_day)]

    day = sums_of_days(session, of_study)
    is_nothing = is_day_of_nothing(day)
    query = (
        sa.select(day.c.participant_id, day.c.local_date, is_nothing, sa.or_(is_nothing, is_measured_whole(day)))
        .where(day.c.status == "closed")
        .order_by(day.c.participant_id, day.c.local_date)
    )
    return [ClosedDay(row[0], row[1], bool(row[2]), bool(row[3])) for row in session.execute(query)]


def _page_of_people(
    session: Session,
    study_id: uuid.UUID,
    first_day: date | None,
    last_day: date | None,
    after: str | None,
    limit: int,
) -> list[uuid.UUID]:
    """The first participants by code, behind a code, who have a day with a meal or a word."""
    has_day = sa.or_(
        *(
            sa.exists().where(table.participant_id == Participant.id, *within(table.local_date, first_day, last_day))
            for table in (Meal, DiaryDay)
        )
    )
    some = sa.select(Participant.id).where(Participant.study_id == study_id, has_day)
    if after is not None:
        some = some.where(Participant.code > after)
    return list(session.scalars(some.order_by(Participant.code).limit(limit)))


def _intake_row(values: sa.RowMapping, person: Participant, *, expects_after_pair: bool) -> IntakeRow:
    return IntakeRow(
        participant_id=person.id,
        participant_code=person.code,
        profile=person.profile,
        first_day=values["first_day"],
        last_day=values["last_day"],
        days=values["days"],
        closed_days=values["closed_days"],
        open_days=values["days"] - values["closed_days"],
        unmeasured_meals=int(values["unmeasured_meals"]),
        unmeasured_items=int(values["unmeasured_items"]),
        provisional_items=int(values["provisional_items"]),
        leftovers_unknown_items=int(values["unseen_leftovers_items"]) if expects_after_pair else 0,
        whole_days=values["whole_days"],
        whole_energy_kcal=values["whole_kcal"],
        means={
            name: MeanAmount(values[name], values[f"{name}_days"], values[f"{name}_coverage"])
            for name in HEADLINE_COLUMNS
        },
    )
