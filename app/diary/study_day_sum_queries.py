"""SQL of what a study's days come to: counted from participants' days, kept (StudyDaySum), and told from there.

A day that has changed since it was written has a mark, of the study or of a participant; it is counted when it is
asked for, so that what is told is of the moment of the question.
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
    FULL,
    how_many,
    is_day_of_nothing,
    is_measured_whole,
    seconds_between,
    total,
    within,
)
from app.diary.day_sum_queries import DayOf, Pair, keys_after
from app.diary.models import DayMark, DaySum, StudyDayMark, StudyDaySum
from app.diary.queries import Conditions, DayTable, sums_of_days
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant

ROWS_AT_A_TIME = 2000
RUNS = ("delays", *HEADLINE_COLUMNS)
COUNTS = tuple(
    column.name for column in StudyDaySum.__table__.columns if column.name not in ("study_id", "local_date", *RUNS)
)
ADDED_UP = tuple(name for name in COUNTS if name in DaySum.__table__.columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class DayCounts:
    """A local day over all participants who have a meal or a closed day: COUNTS of StudyDaySum, and whole days.

    told: with a meal or a closed day, of those who were expected; told_closed of them. closed: by a diary entry, also
    where nothing was expected; ate_nothing of them. whole: closed, everything measured and final, or nothing eaten, and
    all of its energy known; whole_energy_kcal: their mean. open_days: not closed, with some energy known;
    open_energy_kcal: their mean, a lower bound.
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
        """Of those who were expected: with a meal, and not closed."""
        return self.told - self.told_closed

    @property
    def late_share(self) -> float | None:
        """Of the meals; None where there is none."""
        return self.late_meals / self.meals if self.meals else None


@dataclass(frozen=True, slots=True)
class CountedDay:
    """A study's day. delays: seconds from eating to arrival, of each meal.

    amounts: headline column -> its amounts on the participant-days of which all that was eaten is known, with a full
    coverage of it.
    """

    counts: DayCounts
    delays: SortedValues
    amounts: Mapping[str, SortedValues]

    def columns(self) -> dict[str, int | float | SortedValues | None]:
        """The columns of StudyDaySum without its key."""
        return {name: getattr(self.counts, name) for name in COUNTS} | {"delays": self.delays, **self.amounts}


class MarkedDay(NamedTuple):
    """A study's day that has changed. marks: the ids of those of its marks that were seen."""

    study_id: uuid.UUID
    local_date: date
    marks: tuple[int, ...]


def days_of_study(session: Session, study_id: uuid.UUID, first: date, last: date) -> list[CountedDay]:
    """The days of a window, both ends included, that anything is known of, in their order."""
    changed = _changed_days(session, study_id, first, last)
    kept = _kept_days(study_id, first, last).where(StudyDaySum.local_date.not_in(changed))
    days = [_kept_day(row) for row in session.execute(kept).mappings()]
    return sorted(days + count_days(session, study_id, changed), key=lambda day: day.counts.local_date)


def count_days(session: Session, study_id: uuid.UUID, days: Collection[date]) -> list[CountedDay]:
    """What these days of a study come to, those of which something is known, in no order."""
    if not days:
        return []

    def which(table: DayTable) -> Conditions:
        return [table.study_id == study_id, table.local_date.in_(days)]

    day = sums_of_days(session, which)
    amounts, delays = _amounts(session, day), _delays(session, which(Meal))
    none = SortedValues.of(())
    no_amounts = dict.fromkeys(HEADLINE_COLUMNS, none)
    return [
        _counted_day(row, delays.get(row["local_date"], none), amounts.get(row["local_date"], no_amounts))
        for row in session.execute(_counts_of(day)).mappings()
    ]


def next_marked(session: Session) -> MarkedDay | None:
    """The study's day of the newest change, of those of whose participants' days none is marked."""
    is_in_change = sa.exists().where(
        DayMark.study_id == StudyDayMark.study_id, DayMark.local_date == StudyDayMark.local_date
    )
    newest = (
        sa.select(StudyDayMark.study_id, StudyDayMark.local_date)
        .where(~is_in_change)
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
    """Count a study's day and keep it; the marks, read by an earlier statement, are gone."""
    counted = count_days(session, day.study_id, [day.local_date])
    kept = session.get(StudyDaySum, (day.study_id, day.local_date), with_for_update=True)
    if counted:  # updated in place: an erasure that waits for the row finds it
        kept = kept or StudyDaySum(study_id=day.study_id, local_date=day.local_date)
        for name, value in counted[0].columns().items():
            setattr(kept, name, value.to_bytes() if isinstance(value, SortedValues) else value)
        session.add(kept)
    elif kept is not None:
        session.delete(kept)
    session.flush()
    session.execute(
        sa.delete(StudyDayMark).where(StudyDayMark.id.in_(day.marks)).execution_options(synchronize_session=False)
    )


def mark_days(session: Session, days: Collection[DayOf]) -> None:
    """Have these studies' days written anew."""
    session.add_all(StudyDayMark(study_id=study_id, local_date=on) for study_id, on in days)
    session.flush()


def forget_days(session: Session, days: Sequence[DayOf]) -> None:
    """Mark these studies' days, and remove what is kept of them: somebody's meals are erased from them."""
    mark_days(session, days)
    for study_id, on in sorted(days):  # two erasures at once do not wait for each other in a ring
        session.execute(
            sa.delete(StudyDaySum)
            .where(StudyDaySum.study_id == study_id, StudyDaySum.local_date == on)
            .execution_options(synchronize_session=False)
        )


def days_after(session: Session, after: DayOf | None, limit: int) -> list[DayOf]:
    """The first studies' days behind one, by (study, day), that have a participant's sum, or one of their own."""
    return keys_after(session, [(table.study_id, table.local_date) for table in (DaySum, StudyDaySum)], after, limit)


def kept_and_counted(session: Session, days: Sequence[DayOf]) -> list[Pair]:
    """Of these studies' days that are not marked: what is kept of each, and what it comes to."""
    pairs: list[Pair] = []
    for study_id, on in days:
        if not _changed_days(session, study_id, on, on):
            row = session.execute(_kept_days(study_id, on, on)).mappings().one_or_none()
            counted = count_days(session, study_id, [on])
            pairs.append(
                (
                    (study_id, on),
                    _kept_day(row).columns() if row is not None else None,
                    counted[0].columns() if counted else None,
                )
            )
    return pairs


def _kept_days(study_id: uuid.UUID, first: date, last: date) -> AnyQuery:
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
    is_told = sa.or_(day.c.meals > 0, is_closed)
    is_expected = sa.and_(
        sa.or_(Participant.starts_on.is_(None), Participant.starts_on <= day.c.local_date),
        sa.or_(Participant.withdrawn_at.is_(None), Participant.withdrawn_at >= day.c.local_date),
    )
    return (
        sa.select(
            day.c.local_date,
            how_many(sa.and_(is_told, is_expected)).label("told"),
            how_many(sa.and_(is_closed, is_expected)).label("told_closed"),
            how_many(day.c.meals > 0).label("with_meal"),
            how_many(is_closed).label("closed"),
            how_many(sa.and_(is_closed, day.c.said_nothing, day.c.meals == 0)).label("ate_nothing"),
            sa.func.count(open_kcal).label("open_days"),
            sa.func.avg(open_kcal).label("open_energy_kcal"),
            *(total(day.c[name]).label(name) for name in ADDED_UP),
        )
        .join(Participant, Participant.id == day.c.participant_id)
        .group_by(day.c.local_date)
    )


def _amounts(session: Session, day: sa.Subquery) -> dict[date, dict[str, SortedValues]]:
    is_nothing = is_day_of_nothing(day)
    amounts = [
        sa.case((is_nothing, 0.0), (day.c[f"{name}_coverage"] >= FULL, day.c[name])) for name in HEADLINE_COLUMNS
    ]
    query = sa.select(day.c.local_date, *amounts).where(sa.or_(is_nothing, is_measured_whole(day)))
    found: dict[date, list[array[float]]] = {}
    for row in session.execute(query.execution_options(yield_per=ROWS_AT_A_TIME)):
        of_day = found.setdefault(row[0], [array("d") for _ in HEADLINE_COLUMNS])
        for values, value in zip(of_day, row[1:], strict=True):
            if value is not None:
                values.append(value)
    return {on: dict(zip(HEADLINE_COLUMNS, map(SortedValues.of, of_day), strict=True)) for on, of_day in found.items()}


def _delays(session: Session, which: Sequence[sa.ColumnElement[bool]]) -> dict[date, SortedValues]:
    """A day comes as one text: a row a meal would cost several times as much."""
    seconds = sa.func.aggregate_strings(sa.cast(seconds_between(Meal.captured_at, Meal.received_at), sa.Text), " ")
    query = sa.select(Meal.local_date, seconds).where(*which).group_by(Meal.local_date)
    return {row[0]: SortedValues.of(map(float, row[1].split())) for row in session.execute(query)}


def _kept_day(row: sa.RowMapping) -> CountedDay:
    runs = {name: SortedValues.from_bytes(row[name]) for name in RUNS}
    return _counted_day(row, runs.pop("delays"), runs)


def _counted_day(row: sa.RowMapping, delays: SortedValues, amounts: Mapping[str, SortedValues]) -> CountedDay:
    whole = amounts["energy_kcal"]
    counts = DayCounts(
        local_date=row["local_date"],
        whole=len(whole),
        whole_energy_kcal=whole.mean if len(whole) else None,
        **{name: row[name] for name in COUNTS},
    )
    return CountedDay(counts, delays, amounts)
