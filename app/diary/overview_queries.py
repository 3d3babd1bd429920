"""SQL of a study's overview: its people, days, meals that wait, nutrients and places, over a window of local days.

Days are told from what is kept of them (diary/study_day_sum_queries.py), so a study of a million records is told in an
instant, and is right at any moment.
"""

import uuid
from datetime import UTC, date, datetime, time
from typing import Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.day_definition import has_place, within
from app.diary.queries import edge_days, of_study, sums_of_days
from app.diary.study_day_sum_queries import CountedDay, days_of_study
from app.meals.day_models import DiaryDay
from app.meals.models import Meal, MealStatus
from app.people import privacy_queries as privacy
from app.people.models import Participant
from app.records.page_queries import CALENDAR, EASTERNMOST, LATEST_END

CountedStatus = Literal[MealStatus, "after_awaited", "after_failed"]
# somebody or something must act
WAITING: tuple[MealStatus, ...] = (
    "receiving",
    "queued",
    "processing",
    "needs_review",
    "failed",
)
AFTER_PAIRS: tuple[CountedStatus, ...] = ("after_awaited", "after_failed")  # of meals that stand in any status
AFTER_WAITED_FOR = ("receiving", "queued", "processing")
LONG_AGO = datetime(1970, 1, 1, tzinfo=UTC)


class PeopleCounts(NamedTuple):
    """everybody: of the study, those who left it included. active: with a meal in the window.

    erased: of withdrawn, those of whom only this count is left.
    """

    everybody: int
    active: int
    withdrawn: int
    erased: int


class Span(NamedTuple):
    """From when until when days are expected of so many participants: from their start, or first meal or closed day.

    first_day: not before the window, whose first day stands for all that came before it.
    """

    first_day: date
    withdrawn_at: datetime | None
    participants: int


class Place(NamedTuple):
    """Where a meal was eaten, WGS84, degrees, as the study keeps it. meal_id: the phone's."""

    meal_id: uuid.UUID
    participant: str
    captured_at: datetime
    local_date: date
    latitude: float
    longitude: float


class Person(NamedTuple):
    """A participant, and from when their days are expected, if they have begun: their start, else the first told.

    first_day: not before the window, unless it is set, whose first day stands for all that came before it.
    """

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
    """The last local day, not behind `until`, that has a meal or a diary entry."""
    return max(edge_days(session, sa.func.max, of_study(study_id, None, until)), default=None)


def first_day_of(session: Session, study_id: uuid.UUID) -> date | None:
    """The first local day that has a meal or a diary entry."""
    return min(edge_days(session, sa.func.min, of_study(study_id, None, None)), default=None)


class Window:
    """The days of a study from one day to another, both included, as they are in this session's moment."""

    def __init__(self, session: Session, study_id: uuid.UUID, first_day: date, last_day: date) -> None:
        self._session, self._study_id = session, study_id
        self._first_day, self._last_day = first_day, last_day
        self._which = of_study(study_id, first_day, last_day)

    def people(self) -> PeopleCounts:
        """How many there are."""
        has_meal = sa.exists().where(
            Meal.participant_id == Participant.id, *within(Meal.local_date, self._first_day, self._last_day)
        )
        active = sa.func.count(sa.case((has_meal, 1)))
        kept, active_now, left = self._session.execute(
            sa.select(sa.func.count(), active, sa.func.count(Participant.withdrawn_at)).where(
                Participant.study_id == self._study_id
            )
        ).one()
        erased = privacy.count_erased_participants(self._session, self._study_id)
        return PeopleCounts(kept + erased, active_now, left + erased, erased)

    def persons(self) -> list[Person]:
        """All of the study, by code."""
        query = (
            sa.select(Participant.code, _begun(self._first_day), Participant.withdrawn_at)
            .where(Participant.study_id == self._study_id)
            .order_by(Participant.code)
        )
        return [Person(*row) for row in self._session.execute(query)]

    def person_days(self) -> list[PersonDay]:
        """The days that anything is known of, of each participant."""
        day = sums_of_days(self._session, self._which).c
        query = sa.select(Participant.code, day.local_date, day.meals, day.status == "closed").join(
            Participant, Participant.id == day.participant_id
        )
        return [
            PersonDay(code, on, int(meals), bool(closed)) for code, on, meals, closed in self._session.execute(query)
        ]

    def days(self) -> list[CountedDay]:
        """The days that anything is known of, in their order."""
        return days_of_study(self._session, self._study_id, self._first_day, self._last_day)

    def spans(self) -> list[Span]:
        """Of those who have begun."""
        of_study = Participant.study_id == self._study_id
        people = sa.select(_begun(self._first_day).label("begun"), Participant.withdrawn_at).where(of_study).subquery()
        columns = (people.c.begun, people.c.withdrawn_at)
        groups = self._session.execute(sa.select(*columns, sa.func.count()).group_by(*columns))
        # asked here who has not begun: databases would look for each person's first day twice
        return [Span(max(row[0], self._first_day), row[1], row[2]) for row in groups if row[0] is not None]

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


def waiting_of(session: Session, study_id: uuid.UUID) -> dict[CountedStatus, int]:
    """WAITING, then AFTER_PAIRS -> how many meals of a study wait so at this moment, whenever they were eaten."""
    query = (
        sa.select(Meal.status, sa.func.count())
        .where(Meal.study_id == study_id, Meal.status.in_(WAITING))
        .group_by(Meal.status)
    )
    found: dict[CountedStatus, int] = {row[0]: row[1] for row in session.execute(query)}
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


def _begun(first_day: date) -> sa.ColumnElement[date | None]:
    """A participant's set start, else their first day with a meal or first closed one.

    Of those with a meal before the window its first day, which is enough to know and takes one look instead of two.
    """
    has_earlier_meal = sa.exists().where(Meal.participant_id == Participant.id, Meal.local_date < first_day)
    first_meal = sa.select(sa.func.min(Meal.local_date).label("day")).where(Meal.participant_id == Participant.id)
    first_closed = sa.select(sa.func.min(DiaryDay.local_date).label("day")).where(
        DiaryDay.participant_id == Participant.id, DiaryDay.status == "closed"
    )
    told = sa.union_all(first_meal.correlate(Participant), first_closed.correlate(Participant)).subquery()
    return sa.func.coalesce(
        Participant.starts_on,
        sa.case(
            (has_earlier_meal, sa.literal(first_day, sa.Date())),
            else_=sa.select(sa.func.min(told.c.day)).scalar_subquery(),
        ),
    )
