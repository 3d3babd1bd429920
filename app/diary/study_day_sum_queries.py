"""SQL of the sums of a study's days: counted from participants' days, stored as StudyDaySum, and read.

A day that has changed since it was written has a mark, of the study or of a participant, and is counted again when it
is read, so that figures are always current.
"""

import uuid
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.sorted_values import SortedValues
from app.db.statements import AnyQuery
from app.diary.day_definition import (
    count_where,
    is_day_of_nothing,
    is_measured_whole,
    seconds_between,
    total,
    whole_day_amount,
    within,
)
from app.diary.day_sum_queries import Conditions, DayTable, OwnerDay, StoredAndCounted, keys_after, sums_of_days
from app.diary.models import DayMark, DaySum, StudyDayMark, StudyDaySum
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant

ROWS_PER_FETCH = 2000
VALUE_COLUMNS = ("delays", *HEADLINE_COLUMNS)  # stored as SortedValues
COUNTS = tuple(
    column.name
    for column in StudyDaySum.__table__.columns
    if column.name not in ("study_id", "local_date", *VALUE_COLUMNS)
)
SUMMED_COUNTS = tuple(name for name in COUNTS if name in DaySum.__table__.columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class DayCounts:
    """A local day over all participants who have a meal or a closed day: COUNTS of StudyDaySum, and whole days.

    told: participants with a meal or a closed day, of those who were expected; told_closed: of them, with a closed day.
    closed: participants whose day is closed, also those who were not expected; ate_nothing: of them, those who ate
    nothing. whole: closed days that are measured and final, or on which nothing was eaten, with all energy known;
    whole_energy_kcal: their mean. open_days: not closed, with some energy known; open_energy_kcal: their mean, a lower
    bound.
    """

    local_date: date
    told: int = 0
    told_closed: int = 0
    with_meal: int = 0
    closed: int = 0
    ate_nothing: int = 0
    whole: int = 0
    whole_energy_kcal: float | None = None
    open_days: int = 0
    open_energy_kcal: float | None = None
    meals: int = 0
    receiving_meals: int = 0
    queued_meals: int = 0
    processing_meals: int = 0
    estimated_meals: int = 0
    needs_review_meals: int = 0
    failed_meals: int = 0
    confirmed_meals: int = 0
    late_meals: int = 0
    located_meals: int = 0
    unmeasured_meals: int = 0
    items: int = 0
    unmeasured_items: int = 0
    provisional_items: int = 0

    @property
    def told_open(self) -> int:
        """The number of expected participants with a meal whose day is not closed."""
        return self.told - self.told_closed

    @property
    def late_share(self) -> float | None:
        """The share of late meals; None without meals."""
        return self.late_meals / self.meals if self.meals else None


@dataclass(frozen=True, slots=True)
class CountedDay:
    """A study's day. delays: seconds from eating to arrival, per meal.

    amounts: headline column -> its amounts on whole participant-days (see `whole_day_amount`).
    """

    counts: DayCounts
    delays: SortedValues
    amounts: Mapping[str, SortedValues]

    def columns(self) -> dict[str, int | float | SortedValues | None]:
        """The columns of StudyDaySum without its key."""
        return {name: getattr(self.counts, name) for name in COUNTS} | {"delays": self.delays, **self.amounts}


class MarkedDay(NamedTuple):
    """A study's day that has changed. marks: ids of the marks that were read."""

    study_id: uuid.UUID
    local_date: date
    marks: tuple[int, ...]


def days_of_study(session: Session, study_id: uuid.UUID, first: date, last: date) -> list[CountedDay]:
    """Return the days of a window, both ends included, that have data, in order."""
    changed = _changed_days(session, study_id, first, last)
    stored = _stored_days(study_id, first, last).where(StudyDaySum.local_date.not_in(changed))
    days = [_stored_day(row) for row in session.execute(stored).mappings()]
    return sorted(days + count_days(session, study_id, changed), key=lambda day: day.counts.local_date)


def count_days(session: Session, study_id: uuid.UUID, days: Collection[date]) -> list[CountedDay]:
    """Count days of a study from its participants' days; days without data are left out. The order is arbitrary."""
    if not days:
        return []

    def selection(table: DayTable) -> Conditions:
        return [table.study_id == study_id, table.local_date.in_(days)]

    day = sums_of_days(session, selection)
    amounts, delays = _amounts(session, day), _delays(session, selection(Meal))
    no_values = SortedValues.of(())
    no_amounts = dict.fromkeys(HEADLINE_COLUMNS, no_values)
    return [
        _counted_day(row, delays.get(row["local_date"], no_values), amounts.get(row["local_date"], no_amounts))
        for row in session.execute(_counts_of(day)).mappings()
    ]


def next_marked(session: Session) -> MarkedDay | None:
    """Return the most recently marked study day whose participants' days have no marks."""
    has_marked_participant = sa.exists().where(
        DayMark.study_id == StudyDayMark.study_id, DayMark.local_date == StudyDayMark.local_date
    )
    newest = (
        sa.select(StudyDayMark.study_id, StudyDayMark.local_date)
        .where(~has_marked_participant)
        .order_by(StudyDayMark.id.desc())
        .limit(1)
        .subquery()
    )
    query = sa.select(StudyDayMark.study_id, StudyDayMark.local_date, StudyDayMark.id).join(
        newest,
        sa.and_(StudyDayMark.study_id == newest.c.study_id, StudyDayMark.local_date == newest.c.local_date),
    )
    rows = session.execute(query).all()
    return MarkedDay(rows[0][0], rows[0][1], tuple(row[2] for row in rows)) if rows else None


def write_day(session: Session, day: MarkedDay) -> None:
    """Count a study's day, store it and remove the marks, which an earlier statement has read."""
    counted = count_days(session, day.study_id, [day.local_date])
    stored = session.get(StudyDaySum, (day.study_id, day.local_date), with_for_update=True)
    if counted:  # updated in place, so that an erasure that waits for the row finds it
        stored = stored or StudyDaySum(study_id=day.study_id, local_date=day.local_date)
        for name, value in counted[0].columns().items():
            setattr(stored, name, value.to_bytes() if isinstance(value, SortedValues) else value)
        session.add(stored)
    elif stored is not None:
        session.delete(stored)
    session.flush()
    session.execute(
        sa.delete(StudyDayMark).where(StudyDayMark.id.in_(day.marks)).execution_options(synchronize_session=False)
    )


def mark_days(session: Session, days: Collection[OwnerDay]) -> None:
    """Mark studies' days, so that their sums are written again."""
    session.add_all(StudyDayMark(study_id=study_id, local_date=local_date) for study_id, local_date in days)
    session.flush()


def remove_days(session: Session, days: Sequence[OwnerDay]) -> None:
    """Delete the stored sums of studies' days from which meals are erased, and mark the days."""
    mark_days(session, days)
    for study_id, local_date in sorted(days):  # in this order, so that two concurrent erasures do not deadlock
        session.execute(
            sa.delete(StudyDaySum)
            .where(StudyDaySum.study_id == study_id, StudyDaySum.local_date == local_date)
            .execution_options(synchronize_session=False)
        )


def days_after(session: Session, after: OwnerDay | None, limit: int) -> list[OwnerDay]:
    """Return the first studies' days after one, by (study, day), that have a participant's sum or one of their own."""
    return keys_after(session, [(table.study_id, table.local_date) for table in (DaySum, StudyDaySum)], after, limit)


def stored_and_counted(session: Session, days: Sequence[OwnerDay]) -> list[StoredAndCounted]:
    """Return the stored sums and a recount of each unmarked study day."""
    compared: list[StoredAndCounted] = []
    for study_id, local_date in days:
        if not _changed_days(session, study_id, local_date, local_date):
            row = session.execute(_stored_days(study_id, local_date, local_date)).mappings().one_or_none()
            counted = count_days(session, study_id, [local_date])
            compared.append(
                (
                    (study_id, local_date),
                    _stored_day(row).columns() if row is not None else None,
                    counted[0].columns() if counted else None,
                )
            )
    return compared


def _stored_days(study_id: uuid.UUID, first: date, last: date) -> AnyQuery:
    return sa.select(StudyDaySum.__table__).where(
        StudyDaySum.study_id == study_id, *within(StudyDaySum.local_date, first, last)
    )


def _changed_days(session: Session, study_id: uuid.UUID, first: date, last: date) -> list[date]:
    marked = [
        sa.select(table.local_date).where(table.study_id == study_id, *within(table.local_date, first, last))
        for table in (DayMark, StudyDayMark)
    ]
    return list(session.scalars(sa.union(*marked)))


def _counts_of(day: sa.Subquery) -> AnyQuery:
    is_closed = day.c.status == "closed"
    open_kcal = sa.case((~is_closed, day.c.energy_kcal))
    has_entry = sa.or_(day.c.meals > 0, is_closed)
    is_expected = sa.and_(
        sa.or_(Participant.starts_on.is_(None), Participant.starts_on <= day.c.local_date),
        sa.or_(Participant.withdrawn_at.is_(None), Participant.withdrawn_at >= day.c.local_date),
    )
    return (
        sa.select(
            day.c.local_date,
            count_where(sa.and_(has_entry, is_expected)).label("told"),
            count_where(sa.and_(is_closed, is_expected)).label("told_closed"),
            count_where(day.c.meals > 0).label("with_meal"),
            count_where(is_closed).label("closed"),
            count_where(sa.and_(is_closed, day.c.said_nothing, day.c.meals == 0)).label("ate_nothing"),
            sa.func.count(open_kcal).label("open_days"),
            sa.func.avg(open_kcal).label("open_energy_kcal"),
            *(total(day.c[name]).label(name) for name in SUMMED_COUNTS),
        )
        .join(Participant, Participant.id == day.c.participant_id)
        .group_by(day.c.local_date)
    )


def _amounts(session: Session, day: sa.Subquery) -> dict[date, dict[str, SortedValues]]:
    amounts = [whole_day_amount(day, day.c[name], day.c[f"{name}_coverage"]) for name in HEADLINE_COLUMNS]
    query = sa.select(day.c.local_date, *amounts).where(sa.or_(is_day_of_nothing(day), is_measured_whole(day)))
    columns: dict[date, list[array[float]]] = {}
    for row in session.execute(query.execution_options(yield_per=ROWS_PER_FETCH)):
        day_columns = columns.setdefault(row[0], [array("d") for _ in HEADLINE_COLUMNS])
        for values, value in zip(day_columns, row[1:], strict=True):
            if value is not None:
                values.append(value)
    return {
        local_date: dict(zip(HEADLINE_COLUMNS, map(SortedValues.of, day_columns), strict=True))
        for local_date, day_columns in columns.items()
    }


def _delays(session: Session, conditions: Conditions) -> dict[date, SortedValues]:
    """Read each day's delays as one text: one row per meal would take several times as long."""
    seconds = sa.func.aggregate_strings(sa.cast(seconds_between(Meal.captured_at, Meal.received_at), sa.Text), " ")
    query = sa.select(Meal.local_date, seconds).where(*conditions).group_by(Meal.local_date)
    return {row[0]: SortedValues.of(map(float, row[1].split())) for row in session.execute(query)}


def _stored_day(row: sa.RowMapping) -> CountedDay:
    values = {name: SortedValues.from_bytes(row[name]) for name in VALUE_COLUMNS}
    return _counted_day(row, values.pop("delays"), values)


def _counted_day(row: sa.RowMapping, delays: SortedValues, amounts: Mapping[str, SortedValues]) -> CountedDay:
    whole = amounts["energy_kcal"]
    counts = DayCounts(
        local_date=row["local_date"],
        whole=len(whole),
        whole_energy_kcal=whole.mean if len(whole) else None,
        **{name: row[name] for name in COUNTS},
    )
    return CountedDay(counts, delays, amounts)
