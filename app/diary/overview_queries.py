"""SQL of a study's overview: participants, days, waiting meals and places, over a window of local days."""

import uuid
from collections.abc import Iterable
from datetime import UTC, date, datetime, time
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.diary.day_definition import (
    CountedDay,
    count_days,
    count_where,
    days_of_study,
    delay_seconds,
    delays_text,
    has_place,
    within,
)
from app.diary.overview_schemas import CountedStatus, PlaceOut
from app.diary.queries import edge_days
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import MEAL_STATUSES, Meal, MealStatus
from app.people.models import Participant
from app.records.page_queries import CALENDAR, EASTERNMOST, LATEST_END
from app.records.review.queries import count_meals_to_look_at

# states that need an action
WAITING: tuple[MealStatus, ...] = ("receiving", "queued", "processing", "needs_review", "failed")
NEEDS_LOOK: CountedStatus = "needs_look"
AFTER_PAIRS: tuple[CountedStatus, ...] = ("after_awaited", "after_failed")  # of meals in any status
AFTER_PENDING = ("receiving", "queued", "processing")
LATE_SECONDS = 24 * 3600.0  # from eating to arrival; a meal that takes longer is late
SHOWN_DECIMALS = 3  # of degrees: about a hundred metres, finer than a map of a study shows
PLACE_COLUMNS = ("meal_id", "participant", "captured_at", "local_date")
LONG_AGO = datetime(1970, 1, 1, tzinfo=UTC)


class Person(NamedTuple):
    """A participant and the days expected of them.

    first_day: their start, else their first meal or closed day, at the earliest the window's first
    day; None if there is none until its end.
    """

    id: uuid.UUID
    code: str
    starts_on: date | None
    first_day: date | None
    withdrawn_at: datetime | None


class MealsOfDay(NamedTuple):
    """All participants' meals of a local day.

    late: arrived more than LATE_SECONDS after they were eaten
    delays: from eating to arrival, s
    """

    statuses: dict[MealStatus, int]
    late: int
    located: int
    delays: list[float]


def last_day_of(session: Session, study_id: uuid.UUID, until: date) -> date | None:
    """Return the last local day, `until` at the latest, that has a meal or a diary entry."""
    return max(
        edge_days(session, sa.func.max, lambda table: _is_of_study(table, study_id, None, until)),
        default=None,
    )


def first_day_of(session: Session, study_id: uuid.UUID) -> date | None:
    """Return the first local day that has a meal or a diary entry."""
    return min(
        edge_days(session, sa.func.min, lambda table: _is_of_study(table, study_id, None, None)),
        default=None,
    )


class Window:
    """A study's days from one day to another, both included, read in one session."""

    def __init__(
        self, session: Session, study_id: uuid.UUID, first_day: date, last_day: date
    ) -> None:
        self._session, self._study_id = session, study_id
        self._first_day, self._last_day = first_day, last_day
        self._meals = _is_of_study(Meal, study_id, first_day, last_day)

    def persons(self, days: Iterable[CountedDay]) -> list[Person]:
        """Return the study's participants by code. days: the window's, in order."""
        first_days: dict[uuid.UUID, date] = {}
        for day in days:
            if day.meals or day.is_closed:
                first_days.setdefault(day.participant_id, day.local_date)
        person, first_day = Participant, self._first_day
        had_meal = sa.exists().where(Meal.participant_id == person.id, Meal.local_date < first_day)
        had_closed_day = sa.exists().where(
            DiaryDay.participant_id == person.id,
            DiaryDay.local_date < first_day,
            DiaryDay.status == "closed",
        )
        had_begun = sa.or_(had_meal, had_closed_day)
        query = (
            sa.select(person.id, person.code, person.starts_on, person.withdrawn_at, had_begun)
            .where(person.study_id == self._study_id)
            .order_by(person.code)
        )
        persons = []
        for person_id, code, starts_on, withdrawn_at, is_earlier in self._session.execute(query):
            begins_on = first_day if is_earlier else first_days.get(person_id)
            persons.append(Person(person_id, code, starts_on, starts_on or begins_on, withdrawn_at))
        return persons

    def days(self) -> list[CountedDay]:
        """Return the participants' days that have data, in order."""
        chosen = days_of_study(self._study_id, self._first_day, self._last_day)
        return count_days(self._session, chosen)

    def meals(self) -> dict[date, MealsOfDay]:
        """Count the meals of each local day."""
        statuses = [count_where(Meal.status == status) for status in MEAL_STATUSES]
        columns: list[AnyColumn] = [count_where(has_place()), delays_text(), *statuses]
        query = sa.select(Meal.local_date, *columns).where(*self._meals).group_by(Meal.local_date)
        meals = {}
        for local_date, located, text, *counts in self._session.execute(query):
            delays = delay_seconds(text)
            late = sum(delay > LATE_SECONDS for delay in delays)
            by_status = dict(zip(MEAL_STATUSES, counts, strict=True))
            meals[local_date] = MealsOfDay(by_status, late, located, delays)
        return meals

    def places(self, limit: int) -> list[PlaceOut]:
        """Return the newest places, by (captured_at, id), rounded to SHOWN_DECIMALS."""
        latitude, longitude = (
            Meal.details["location"][name].as_float() for name in ("latitude", "longitude")
        )
        first, last = (
            min(max(day, CALENDAR[0]), CALENDAR[1]) for day in (self._first_day, self._last_day)
        )
        begins, ends = (datetime.combine(day, time.min, UTC) for day in (first, last))
        query = (
            sa.select(
                Meal.client_id,
                Participant.code,
                Meal.captured_at,
                Meal.local_date,
                latitude,
                longitude,
            )
            .join(Participant, Participant.id == Meal.participant_id)
            .where(*self._meals, has_place())
            .where(Meal.captured_at >= begins - EASTERNMOST, Meal.captured_at < ends + LATEST_END)
            .order_by(Meal.captured_at.desc(), Meal.id.desc())
            .limit(limit)
        )
        return [
            PlaceOut(
                **dict(zip(PLACE_COLUMNS, row[:-2], strict=True)),
                latitude=round(row[-2], SHOWN_DECIMALS),
                longitude=round(row[-1], SHOWN_DECIMALS),
            )
            for row in self._session.execute(query)
        ]


def count_waiting(session: Session, study_id: uuid.UUID) -> dict[CountedStatus, int]:
    """Count a study's meals that wait now, whenever they were eaten, by WAITING, needs_look, then AFTER_PAIRS."""
    query = (
        sa.select(Meal.status, sa.func.count())
        .where(Meal.study_id == study_id, Meal.status.in_(WAITING))
        .group_by(Meal.status)
    )
    counts: dict[CountedStatus, int] = {row[0]: row[1] for row in session.execute(query)}
    counts[NEEDS_LOOK] = count_meals_to_look_at(session, study_id)
    # few meals of all studies have a due time: coalesce keeps SQLite from scanning all of this study's meals instead,
    # and IS NOT NULL would not use an index
    is_in_study = sa.func.coalesce(Meal.study_id, study_id) == study_id
    is_pending = sa.or_(Meal.after_status.is_(None), Meal.after_status.in_(AFTER_PENDING))
    conditions = (
        (is_in_study, Meal.after_due_at > LONG_AGO, is_pending),
        (Meal.study_id == study_id, Meal.after_status == "failed"),
    )
    for name, condition in zip(AFTER_PAIRS, conditions, strict=True):
        count = sa.select(sa.func.count()).select_from(Meal).where(*condition)
        counts[name] = session.execute(count).scalar_one()
    return {name: counts.get(name, 0) for name in (*WAITING, NEEDS_LOOK, *AFTER_PAIRS)}


def count_failures(session: Session, study_id: uuid.UUID) -> dict[str, int]:
    """Count a study's failed meals by failure code, the most frequent first."""
    query = (
        sa.select(Meal.failure_code, sa.func.count())
        .where(Meal.study_id == study_id, Meal.failure_code.is_not(None), Meal.status == "failed")
        .group_by(Meal.failure_code)
        .order_by(sa.func.count().desc(), Meal.failure_code)
    )
    return {str(row[0]): row[1] for row in session.execute(query)}


def _is_of_study(
    table: type[Meal | DiaryDay], study_id: uuid.UUID, first_day: date | None, last_day: date | None
) -> list[sa.ColumnElement[bool]]:
    return [table.study_id == study_id, *within(table.local_date, first_day, last_day)]
