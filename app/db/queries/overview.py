"""SQL of a study's overview: its people, days, meals that wait, nutrients and places, over a window of local days.

Days are summed from what is kept of them (db/queries/days.py, sums_of_days), so a study of a million records is summed
in an instant, and is right at any moment.
"""

import uuid
from array import array
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import DayMark, DaySum, DiaryDay, Meal, Participant
from app.db.models.meal import MEAL_STATUSES
from app.db.models.record import HEADLINE_COLUMNS
from app.db.queries.day_definition import FULL, STATUS_COLUMNS, has_place, seconds_between
from app.db.queries.days import sums_of_days
from app.db.queries.intakes import is_day_of_nothing, is_measured_whole, within
from app.db.queries.record_pages import CALENDAR, EASTERNMOST, LATEST_END

WAITING = ("receiving", "queued", "processing", "needs_review", "failed")  # somebody or something must act
AFTER_PAIRS = ("after_awaited", "after_failed")  # of meals that stand in any status
AFTER_WAITED_FOR = ("receiving", "queued", "processing")
LONG_AGO = datetime(1970, 1, 1, tzinfo=UTC)
ROWS_AT_A_TIME = 2000


class PeopleCounts(NamedTuple):
    """everybody: of the study, those who left it included. active: with a meal in the window."""

    everybody: int
    active: int
    withdrawn: int


class Span(NamedTuple):
    """From when until when days are expected of so many participants: from their start, or first meal or closed day.

    first_day: not before the window, whose first day stands for all that came before it.
    """

    first_day: date
    withdrawn_at: datetime | None
    participants: int


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


class Place(NamedTuple):
    """Where a meal was eaten, WGS84, degrees, as the study keeps it."""

    meal_client_id: uuid.UUID
    participant_code: str
    captured_at: datetime
    local_date: date
    latitude: float
    longitude: float


class Person(NamedTuple):
    """A participant, and from when their days are expected, if they have begun: their start, else the first told."""

    code: str
    first_day: date | None
    withdrawn_at: datetime | None


class PersonDay(NamedTuple):
    """What is known of a participant's day."""

    code: str
    local_date: date
    meals: int
    is_closed: bool


def last_day_of(session: Session, study_id: uuid.UUID, until: date) -> date | None:
    """The last local day, not behind `until`, that has a meal or a word."""
    found = [
        session.scalar(
            sa.select(sa.func.max(table.local_date)).where(table.study_id == study_id, table.local_date <= until)
        )
        for table in (Meal, DiaryDay)
    ]
    return max((day for day in found if day is not None), default=None)


def first_day_of(session: Session, study_id: uuid.UUID) -> date | None:
    """The first local day that has a meal or a word."""
    found = [
        session.scalar(sa.select(sa.func.min(table.local_date)).where(table.study_id == study_id))
        for table in (Meal, DiaryDay)
    ]
    return min((day for day in found if day is not None), default=None)


class Window:
    """The days of a study from one day to another, both included, as they are in this session's moment."""

    def __init__(self, session: Session, study_id: uuid.UUID, first_day: date, last_day: date) -> None:
        self._session, self._study_id = session, study_id
        self._first_day, self._last_day = first_day, last_day
        self._day = sums_of_days(session, self._which)

    def _which(self, table: type[DaySum | DayMark | Meal]) -> list[sa.ColumnElement[bool]]:
        return [table.study_id == self._study_id, *within(table.local_date, self._first_day, self._last_day)]

    def people(self) -> PeopleCounts:
        """How many there are."""
        everybody, withdrawn = self._session.execute(
            sa.select(sa.func.count(), sa.func.count(Participant.withdrawn_at)).where(
                Participant.study_id == self._study_id
            )
        ).one()
        active = sa.select(sa.func.count(self._day.c.participant_id.distinct())).where(self._day.c.meals > 0)
        return PeopleCounts(everybody, self._session.execute(active).scalar_one(), withdrawn)

    def persons(self) -> list[Person]:
        """All of the study, by code."""
        first_meal = (
            sa.select(sa.func.min(Meal.local_date)).where(Meal.participant_id == Participant.id).scalar_subquery()
        )
        first_closed = (
            sa.select(sa.func.min(DiaryDay.local_date))
            .where(DiaryDay.participant_id == Participant.id, DiaryDay.status == "closed")
            .scalar_subquery()
        )
        query = (
            sa.select(Participant.code, Participant.starts_on, first_meal, first_closed, Participant.withdrawn_at)
            .where(Participant.study_id == self._study_id)
            .order_by(Participant.code)
        )
        return [
            Person(code, starts_on or min((day for day in told if day is not None), default=None), withdrawn_at)
            for code, starts_on, *told, withdrawn_at in self._session.execute(query)
        ]

    def person_days(self) -> list[PersonDay]:
        """The days that anything is known of, of each participant."""
        day = self._day.c
        query = sa.select(Participant.code, day.local_date, day.meals, day.status == "closed").join(
            Participant, Participant.id == day.participant_id
        )
        return [
            PersonDay(code, on, int(meals), bool(closed)) for code, on, meals, closed in self._session.execute(query)
        ]

    def days(self) -> list[DayCounts]:
        """The days that anything is known of, in their order."""
        day = self._day.c
        is_closed, is_nothing = day.status == "closed", is_day_of_nothing(self._day)
        is_whole = sa.and_(is_measured_whole(self._day), day.energy_kcal_coverage >= FULL)
        whole_kcal = sa.case((is_nothing, 0.0), (is_whole, day.energy_kcal))
        open_kcal = sa.case((~is_closed, day.energy_kcal))
        is_told = sa.or_(day.meals > 0, is_closed)
        is_expected = sa.and_(
            sa.or_(Participant.starts_on.is_(None), Participant.starts_on <= day.local_date),
            sa.or_(Participant.withdrawn_at.is_(None), Participant.withdrawn_at >= day.local_date),
        )
        summed = ("meals", *STATUS_COLUMNS, "late_meals", "located_meals", "unmeasured_meals", "items",
                  "unmeasured_items", "provisional_items")  # fmt: skip
        query = (
            sa.select(
                day.local_date,
                _how_many(sa.and_(is_told, is_expected)).label("told"),
                _how_many(sa.and_(is_closed, is_expected)).label("told_closed"),
                _how_many(day.meals > 0).label("with_meal"),
                _how_many(is_closed).label("closed"),
                _how_many(sa.and_(is_closed, day.said_nothing, day.meals == 0)).label("ate_nothing"),
                sa.func.count(whole_kcal).label("whole"),
                sa.func.avg(whole_kcal).label("whole_energy_kcal"),
                sa.func.count(open_kcal).label("open_days"),
                sa.func.avg(open_kcal).label("open_energy_kcal"),
                *(sa.func.sum(day[name]).label(f"sum_{name}") for name in summed),
            )
            .join(Participant, Participant.id == day.participant_id)
            .group_by(day.local_date)
            .order_by(day.local_date)
        )
        return [_day_counts(row) for row in self._session.execute(query).mappings()]

    def spans(self) -> list[Span]:
        """Of those who have begun, or begin within the window."""
        begun, first = self._has_begun_before(), self._first_day
        groups = (
            sa.select(Participant.starts_on, Participant.withdrawn_at, sa.func.count(), _how_many(begun))
            .where(Participant.study_id == self._study_id)
            .group_by(Participant.starts_on, Participant.withdrawn_at)
        )
        found, are_all_begun = [], True
        for starts_on, withdrawn_at, count, count_begun in self._session.execute(groups):
            if starts_on is not None:
                found.append(Span(max(starts_on, first), withdrawn_at, count))
                continue
            found.append(Span(first, withdrawn_at, int(count_begun)))
            are_all_begun &= count == count_begun
        return found if are_all_begun else [*found, *self._beginners(begun)]

    def _has_begun_before(self) -> sa.ColumnElement[bool]:
        """Whether a participant without a set start had a meal or a closed day before the window."""
        has_meal = sa.exists().where(Meal.participant_id == Participant.id, Meal.local_date < self._first_day)
        has_closed = sa.exists().where(
            DiaryDay.participant_id == Participant.id,
            DiaryDay.local_date < self._first_day,
            DiaryDay.status == "closed",
        )
        return sa.and_(Participant.starts_on.is_(None), sa.or_(has_meal, has_closed))

    def _beginners(self, begun: sa.ColumnElement[bool]) -> list[Span]:
        """Those without a set start whose first meal or closed day is in the window."""
        day = self._day.c
        first_days = (
            sa.select(day.participant_id, sa.func.min(day.local_date).label("first_day"))
            .where(sa.or_(day.meals > 0, day.status == "closed"))
            .group_by(day.participant_id)
            .subquery()
        )
        columns = (first_days.c.first_day, Participant.withdrawn_at)
        query = (
            sa.select(*columns, sa.func.count())
            .join(Participant, Participant.id == first_days.c.participant_id)
            .where(Participant.starts_on.is_(None), ~begun)
            .group_by(*columns)
        )
        return [Span(*row) for row in self._session.execute(query)]

    def nutrients(self) -> dict[str, "array[float]"]:
        """Column -> its amounts on the days of which all that was eaten is known, with a full coverage of it."""
        day = self._day.c
        is_nothing = is_day_of_nothing(self._day)
        amounts = [
            sa.case((is_nothing, 0.0), (day[f"{name}_coverage"] >= FULL, day[name])) for name in HEADLINE_COLUMNS
        ]
        query = sa.select(*amounts).where(sa.or_(is_nothing, is_measured_whole(self._day)))
        found = {name: array("d") for name in HEADLINE_COLUMNS}
        rows = self._session.execute(query.execution_options(yield_per=ROWS_AT_A_TIME))
        for part in rows.partitions():
            for name, values in zip(HEADLINE_COLUMNS, zip(*part, strict=True), strict=True):
                found[name].extend(value for value in values if value is not None)
        return found

    def delays(self) -> dict[date, "array[float]"]:
        """Day -> seconds from eating to arrival of each of its meals, in no order.

        A day comes as one text: a row a meal would cost several times as much.
        """
        seconds = sa.func.aggregate_strings(sa.cast(seconds_between(Meal.captured_at, Meal.received_at), sa.Text), " ")
        query = sa.select(Meal.local_date, seconds).where(*self._which(Meal)).group_by(Meal.local_date)
        return {row[0]: array("d", map(float, row[1].split())) for row in self._session.execute(query)}

    def places(self, limit: int) -> list[Place]:
        """The newest places, by (captured_at, id)."""
        latitude, longitude = (Meal.details["location"][name].as_float() for name in ("latitude", "longitude"))
        first, last = (min(max(day, CALENDAR[0]), CALENDAR[1]) for day in (self._first_day, self._last_day))
        begins, ends = (datetime.combine(day, time.min, UTC) for day in (first, last))
        query = (
            sa.select(Meal.client_id, Participant.code, Meal.captured_at, Meal.local_date, latitude, longitude)
            .join(Participant, Participant.id == Meal.participant_id)
            .where(*self._which(Meal), has_place())
            .where(Meal.captured_at >= begins - EASTERNMOST, Meal.captured_at < ends + LATEST_END)
            .order_by(Meal.captured_at.desc(), Meal.id.desc())
            .limit(limit)
        )
        return [Place(*row) for row in self._session.execute(query)]


def waiting_of(session: Session, study_id: uuid.UUID) -> dict[str, int]:
    """WAITING, then AFTER_PAIRS -> how many meals of a study wait so at this moment, whenever they were eaten."""
    query = (
        sa.select(Meal.status, sa.func.count())
        .where(Meal.study_id == study_id, Meal.status.in_(WAITING))
        .group_by(Meal.status)
    )
    found = {row[0]: row[1] for row in session.execute(query)}
    # few meals have a term, of all studies together: coalesce keeps SQLite from looking through all of this study's,
    # and IS NOT NULL would not be looked up in an index
    is_of_study = sa.func.coalesce(Meal.study_id, study_id) == study_id
    is_not_there = sa.or_(Meal.after_status.is_(None), Meal.after_status.in_(AFTER_WAITED_FOR))
    conditions = (
        (is_of_study, Meal.after_due_at > LONG_AGO, is_not_there),
        (Meal.study_id == study_id, Meal.after_status == "failed"),
    )
    for name, condition in zip(AFTER_PAIRS, conditions, strict=True):
        counted = sa.select(sa.func.count()).select_from(Meal).where(*condition)
        found[name] = session.execute(counted).scalar_one()
    return {name: found.get(name, 0) for name in (*WAITING, *AFTER_PAIRS)}


def failures_of(session: Session, study_id: uuid.UUID) -> dict[str, int]:
    """Code -> how many meals of a study stand failed by it at this moment, the commonest first."""
    query = (
        sa.select(Meal.failure_code, sa.func.count())
        .where(Meal.study_id == study_id, Meal.failure_code.is_not(None), Meal.status == "failed")
        .group_by(Meal.failure_code)
        .order_by(sa.func.count().desc(), Meal.failure_code)
    )
    return {str(row[0]): row[1] for row in session.execute(query)}


def _day_counts(row: sa.RowMapping) -> DayCounts:
    return DayCounts(
        local_date=row["local_date"],
        told=int(row["told"]),
        told_closed=int(row["told_closed"]),
        with_meal=int(row["with_meal"]),
        closed=int(row["closed"]),
        ate_nothing=int(row["ate_nothing"]),
        whole=row["whole"],
        whole_energy_kcal=row["whole_energy_kcal"],
        open_days=row["open_days"],
        open_energy_kcal=row["open_energy_kcal"],
        meals=int(row["sum_meals"]),
        by_status={status: int(row[f"sum_{status}_meals"]) for status in MEAL_STATUSES},
        late_meals=int(row["sum_late_meals"]),
        located_meals=int(row["sum_located_meals"]),
        unmeasured_meals=int(row["sum_unmeasured_meals"]),
        items=int(row["sum_items"]),
        unmeasured_items=int(row["sum_unmeasured_items"]),
        provisional_items=int(row["sum_provisional_items"]),
    )


def _how_many(condition: Any) -> sa.ColumnElement[int]:
    return sa.func.sum(sa.case((condition, 1), else_=0))
