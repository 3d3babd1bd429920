"""SQL of what a study's days come to: counted from participants' days, kept (StudyDaySum), and told from there.

A day that has changed since it was written has a mark, of the study or of a participant; it is counted when it is
asked for, so that what is told is of the moment of the question.
"""

import uuid
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import date
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.sorted_values import SortedValues
from app.db.statements import AnyQuery
from app.diary.day_definition import FULL, STATUS_COLUMNS, seconds_between
from app.diary.day_sum_queries import keys_after
from app.diary.intake_queries import is_day_of_nothing, is_measured_whole, within
from app.diary.models import DayMark, DaySum, StudyDayMark, StudyDaySum
from app.diary.queries import sums_of_days
from app.meals.models import MEAL_STATUSES, Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant

ROWS_AT_A_TIME = 2000
ADDED_UP = (
    "meals",
    *STATUS_COLUMNS,
    "late_meals",
    "located_meals",
    "unmeasured_meals",
    "items",
    "unmeasured_items",
    "provisional_items",
)  # of DaySum

StudyDayKey = tuple[uuid.UUID, date]  # study, local day


@dataclass(frozen=True, slots=True)
class DayCounts:
    """A local day over all participants, who each have a row, a meal or a closed day, or are silent.

    told: with a meal or a closed day, of those who were expected; told_closed of them. closed: by word, also of days
    on which nothing was expected; ate_nothing of them. whole: closed, everything measured and final, or nothing eaten,
    and all of its energy known; whole_energy_kcal: their mean.
    open_days: not closed, with some energy known; open_energy_kcal: their mean, a lower bound. by_status: meals.
    """

    local_date: date
    told: int
    told_closed: int
    with_meal: int
    closed: int
    ate_nothing: int
    whole: int
    whole_energy_kcal: float | None
    open_days: int
    open_energy_kcal: float | None
    meals: int
    by_status: dict[str, int]
    late_meals: int
    located_meals: int
    unmeasured_meals: int
    items: int
    unmeasured_items: int
    provisional_items: int

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


class MarkedDay(NamedTuple):
    """A study's day that has changed. marks: the ids of those of its marks that were seen."""

    study_id: uuid.UUID
    local_date: date
    marks: tuple[int, ...]


def days_of_study(session: Session, study_id: uuid.UUID, first: date, last: date) -> list[CountedDay]:
    """The days of a window, both ends included, that anything is known of, in their order."""
    changed = _changed_days(session, study_id, first, last)
    kept = sa.select(StudyDaySum.__table__).where(
        StudyDaySum.study_id == study_id,
        *within(StudyDaySum.local_date, first, last),
        StudyDaySum.local_date.not_in(changed),
    )
    found = [_kept_day(row) for row in session.execute(kept).mappings()]
    found += count_days(session, study_id, changed)
    return sorted(found, key=lambda day: day.counts.local_date)


def count_days(session: Session, study_id: uuid.UUID, days: Collection[date]) -> list[CountedDay]:
    """What these days of a study come to, those of which something is known, in no order."""
    if not days:
        return []

    def which(table: type[DaySum | DayMark | Meal]) -> list[sa.ColumnElement[bool]]:
        return [table.study_id == study_id, table.local_date.in_(days)]

    day = sums_of_days(session, which)
    amounts, delays = _amounts(session, day), _delays(session, which(Meal))
    nothing = {name: SortedValues.of(()) for name in HEADLINE_COLUMNS}
    found = []
    for row in session.execute(_counts_of(day)).mappings():
        on = row["local_date"]
        of_day = amounts.get(on, nothing)
        found.append(
            CountedDay(_day_counts(row, of_day["energy_kcal"]), delays.get(on, SortedValues.of(())), of_day),
        )
    return found


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
    if counted and kept is None:
        session.add(StudyDaySum(study_id=day.study_id, local_date=day.local_date, **_values_of(counted[0])))
    elif counted and kept is not None:  # in its place: an erasure that waits for the row finds it
        for name, value in _values_of(counted[0]).items():
            setattr(kept, name, value)
    elif kept is not None:
        session.delete(kept)
    session.flush()
    session.execute(
        sa.delete(StudyDayMark).where(StudyDayMark.id.in_(day.marks)).execution_options(synchronize_session=False)
    )


def mark_days(session: Session, days: Collection[StudyDayKey]) -> None:
    """Have these studies' days written anew."""
    session.add_all(StudyDayMark(study_id=study_id, local_date=on) for study_id, on in days)
    session.flush()


def forget_days(session: Session, days: Sequence[StudyDayKey]) -> None:
    """Mark these studies' days, and remove what is kept of them: somebody's meals are erased from them."""
    mark_days(session, days)
    for study_id, on in sorted(days):  # two erasures at once do not wait for each other in a ring
        session.execute(
            sa.delete(StudyDaySum)
            .where(StudyDaySum.study_id == study_id, StudyDaySum.local_date == on)
            .execution_options(synchronize_session=False)
        )


def days_after(session: Session, after: StudyDayKey | None, limit: int) -> list[StudyDayKey]:
    """The first studies' days behind one, by (study, day), that have a participant's sum, or one of their own."""
    return keys_after(session, (DaySum, StudyDaySum), "study_id", after, limit)


def kept_and_counted(session: Session, key: StudyDayKey) -> tuple[CountedDay | None, CountedDay | None] | None:
    """What is kept of a study's day, and what it comes to; None of a day that is marked."""
    study_id, on = key
    if _changed_days(session, study_id, on, on):
        return None
    row = session.execute(
        sa.select(StudyDaySum.__table__).where(StudyDaySum.study_id == study_id, StudyDaySum.local_date == on)
    ).mappings().one_or_none()  # fmt: skip
    return _kept_day(row) if row is not None else None, next(iter(count_days(session, study_id, [on])), None)


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
            _how_many(sa.and_(is_told, is_expected)).label("told"),
            _how_many(sa.and_(is_closed, is_expected)).label("told_closed"),
            _how_many(day.c.meals > 0).label("with_meal"),
            _how_many(is_closed).label("closed"),
            _how_many(sa.and_(is_closed, day.c.said_nothing, day.c.meals == 0)).label("ate_nothing"),
            sa.func.count(open_kcal).label("open_days"),
            sa.func.avg(open_kcal).label("open_energy_kcal"),
            *(sa.func.sum(day.c[name]).label(name) for name in ADDED_UP),
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


def _values_of(day: CountedDay) -> dict[str, Any]:
    """A day as StudyDaySum keeps it, without its key."""
    derived = ("local_date", "by_status", "whole", "whole_energy_kcal")
    counts = {field.name: getattr(day.counts, field.name) for field in fields(DayCounts) if field.name not in derived}
    by_status = {f"{status}_meals": day.counts.by_status[status] for status in MEAL_STATUSES}
    runs = {name: values.to_bytes() for name, values in day.amounts.items()}
    return counts | by_status | {"delays": day.delays.to_bytes()} | runs


def _kept_day(row: sa.RowMapping) -> CountedDay:
    amounts = {name: SortedValues.from_bytes(row[name]) for name in HEADLINE_COLUMNS}
    return CountedDay(_day_counts(row, amounts["energy_kcal"]), SortedValues.from_bytes(row["delays"]), amounts)


def _day_counts(row: sa.RowMapping, whole_kcal: SortedValues) -> DayCounts:
    return DayCounts(
        local_date=row["local_date"],
        told=int(row["told"]),
        told_closed=int(row["told_closed"]),
        with_meal=int(row["with_meal"]),
        closed=int(row["closed"]),
        ate_nothing=int(row["ate_nothing"]),
        whole=len(whole_kcal),
        whole_energy_kcal=whole_kcal.mean if len(whole_kcal) else None,
        open_days=int(row["open_days"]),
        open_energy_kcal=row["open_energy_kcal"],
        meals=int(row["meals"]),
        by_status={status: int(row[f"{status}_meals"]) for status in MEAL_STATUSES},
        late_meals=int(row["late_meals"]),
        located_meals=int(row["located_meals"]),
        unmeasured_meals=int(row["unmeasured_meals"]),
        items=int(row["items"]),
        unmeasured_items=int(row["unmeasured_items"]),
        provisional_items=int(row["provisional_items"]),
    )


def _how_many(condition: Any) -> sa.ColumnElement[int]:
    return sa.func.sum(sa.case((condition, 1), else_=0))
