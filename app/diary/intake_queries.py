"""SQL of intakes: means over participants' closed days."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.diary.day_definition import is_day_of_nothing, total, whole_day_amount, within
from app.diary.day_sum_queries import Conditions, DayTable, sums_of_days
from app.meals.day_models import DiaryDay
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study
from app.people.profiles import Profile


class MeanAmount(NamedTuple):
    """A mean daily amount over closed days, the number of them on which it is known, and their mean coverage.

    mean: None if it is known on no closed day. coverage: None if it is unknown on one of the closed days.
    """

    mean: float | None
    days: int
    coverage: float | None


@dataclass(frozen=True)
class IntakeRow:
    """A participant's mean daily intake over closed days.

    first_day, last_day: of all days with a meal or a diary entry; days: their number. whole_days: closed days that are
    measured and final, with all energy known; whole_energy_kcal: their mean energy.
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

    def selection(table: DayTable) -> Conditions:
        return [table.participant_id.in_(participant_ids), *within(table.local_date, first_day, last_day)]

    day = sums_of_days(session, selection)
    is_closed, is_nothing = day.c.status == "closed", is_day_of_nothing(day)
    closed_days = sa.func.count(sa.case((is_closed, 1)))
    whole_kcal = whole_day_amount(day, day.c.energy_kcal, day.c.energy_kcal_coverage)
    columns: dict[str, AnyColumn] = {
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
    means: list[AnyColumn] = []
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
    participants = sa.select(Participant.id, Participant.code, Participant.profile).where(
        Participant.id.in_(participant_ids)
    )
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
        for participant_id, code, profile in session.execute(participants.order_by(Participant.code))
    ]


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
            sa.exists().where(table.participant_id == Participant.id, *within(table.local_date, first_day, last_day))
            for table in (Meal, DiaryDay)
        )
    )
    query = sa.select(Participant.id).where(Participant.study_id == study_id, has_day)
    if after is not None:
        query = query.where(Participant.code > after)
    return list(session.scalars(query.order_by(Participant.code).limit(limit)))
