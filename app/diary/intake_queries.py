"""SQL of intakes: means over participants' closed days, and which days those are."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.day_definition import FULL, is_day_of_nothing, is_measured_whole, total, within
from app.diary.queries import Conditions, DayTable, of_study, sums_of_days
from app.meals.day_models import DiaryDay
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study


class MeanAmount(NamedTuple):
    """A mean daily amount over closed days, on how many of them it is known, and the mean of their coverages.

    mean: None where it is known on no closed day. coverage: None where one of the days has none.
    """

    mean: float | None
    days: int
    coverage: float | None


class ClosedDay(NamedTuple):
    """is_nothing: nothing was eaten. is_whole: nothing was, or the eaten grams of everything are known and final."""

    participant_id: uuid.UUID
    local_date: date
    is_nothing: bool
    is_whole: bool


@dataclass(frozen=True)
class IntakeRow:
    """A participant's mean daily intake over closed days.

    first_day, last_day: of all days with a meal or a diary entry; days: their number. whole_days: closed days of which
    everything is measured, final, and has an energy; whole_energy_kcal: their mean energy.
    """

    participant: str
    profile: Mapping[str, Any] | None
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
        """Days that are not closed: left out of the means."""
        return self.days - self.closed_days

    @property
    def silent_days(self) -> int:
        """Days between the first and the last without a meal or a diary entry."""
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
    """Mean intakes of at most `limit` participants who have a day, by code, those behind `after`."""
    people = _page_of_people(session, study.id, first_day, last_day, after, limit)
    if not people:
        return []

    def of_people(table: DayTable) -> Conditions:
        return [table.participant_id.in_(people), *within(table.local_date, first_day, last_day)]

    day = sums_of_days(session, of_people)
    is_closed, is_nothing = day.c.status == "closed", is_day_of_nothing(day)
    is_measured = sa.and_(is_measured_whole(day), day.c.energy_kcal_coverage >= FULL)
    closed_days = sa.func.count(sa.case((is_closed, 1)))
    whole_kcal = sa.case((is_nothing, 0.0), (is_measured, day.c.energy_kcal))
    columns: dict[str, sa.ColumnElement[Any]] = {
        "first_day": sa.func.min(day.c.local_date),
        "last_day": sa.func.max(day.c.local_date),
        "days": sa.func.count(),
        "closed_days": closed_days,
        "whole_days": sa.func.count(whole_kcal),
        "whole_energy_kcal": sa.func.avg(whole_kcal),
    }
    for name in ("unmeasured_meals", "unmeasured_items", "provisional_items", "unseen_leftovers_items"):
        columns[name] = total(sa.case((is_closed, day.c[name]), else_=0))
    unseen = columns.pop("unseen_leftovers_items")
    columns["leftovers_unknown_items"] = unseen if study.expects_after_pair else sa.literal(0)
    means: list[sa.ColumnElement[Any]] = []
    for name in HEADLINE_COLUMNS:
        amount = sa.case((is_nothing, 0.0), (is_closed, day.c[name]))
        coverage = sa.case((is_nothing, 1.0), (is_closed, day.c[f"{name}_coverage"]))
        means += [
            sa.func.avg(amount).label(name),
            sa.func.count(amount).label(f"{name}_days"),
            sa.case((sa.func.count(coverage) == closed_days, sa.func.avg(coverage))).label(f"{name}_coverage"),
        ]
    query = sa.select(day.c.participant_id, *(column.label(name) for name, column in columns.items()), *means).group_by(
        day.c.participant_id
    )
    rows = {row["participant_id"]: row for row in session.execute(query).mappings()}
    persons = sa.select(Participant.id, Participant.code, Participant.profile).where(Participant.id.in_(people))
    return [
        IntakeRow(
            participant=code,
            profile=profile,
            **{name: rows[participant_id][name] for name in columns},
            components={
                name: MeanAmount(*(rows[participant_id][f"{name}{end}"] for end in ("", "_days", "_coverage")))
                for name in HEADLINE_COLUMNS
            },
        )
        for participant_id, code, profile in session.execute(persons.order_by(Participant.code))
    ]


def closed_days(
    session: Session, study_id: uuid.UUID, first_day: date | None, last_day: date | None
) -> list[ClosedDay]:
    """The closed days of a study."""
    day = sums_of_days(session, of_study(study_id, first_day, last_day))
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
