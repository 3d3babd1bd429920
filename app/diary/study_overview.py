"""What a study's overview tells, over a window of local days: people, days, what waits, nutrients, places.

Every figure comes from one moment (one read transaction). What is not known is None, never 0; means and distributions
are over whole days (closed, everything measured and final, or nothing eaten), and tell over how many.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta

from app.core.errors import InvalidInputError, NotFoundError
from app.db.session import Database
from app.db.sorted_values import Runs
from app.diary import overview_queries as overview
from app.diary.diary import MAX_RANGE_DAYS
from app.diary.distribution import Distribution, distribution
from app.diary.overview_queries import CountedStatus, PeopleCounts, Place, Span
from app.diary.study_day_sum_queries import CountedDay, DayCounts
from app.http.paging import require_order
from app.meals.meal_time import latest_day
from app.meals.models import MEAL_STATUSES, MealStatus
from app.meals.record_models import HEADLINE_COLUMNS
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import Caller, StaffCaller
from app.people.models import Study
from app.people.studies import enter_study

USUAL_DAYS = 28
MOST_PLACES = 2000
MOST_PERSONS = 60  # whose days are told one by one
MOST_DAYS_OF_PERSONS = 35
SHOWN_DECIMALS = 3  # of degrees: some hundred metres, more than a map of a study shows


@dataclass(frozen=True, slots=True)
class OverviewDay:
    """A local day of the window. expected: participants whose day it is; silent: those without meal and closed day.

    median_delay_seconds: from eating to arrival, of the day's meals.
    """

    counts: DayCounts
    expected: int
    silent: int
    median_delay_seconds: float | None


@dataclass(frozen=True, slots=True)
class Completeness:
    """Participant-days of the window: expected, with a meal or closed (told), closed, whole, silent; late meals.

    late_meals: arrived more than 24 hours after they were eaten. median_delay_seconds: from eating to arrival.
    """

    expected: int
    told: int
    closed: int
    whole: int
    silent: int
    meals: int
    late_meals: int
    median_delay_seconds: float | None


@dataclass(frozen=True, slots=True)
class Places:
    """Meals of the window whose place is kept: how many, and the newest of them, rounded to SHOWN_DECIMALS."""

    total: int
    shown: tuple[Place, ...]


@dataclass(frozen=True, slots=True)
class DayOfPerson:
    """A participant's day of the window that was expected or is known. Silent: expected, without meal, not closed."""

    participant_code: str
    local_date: date
    is_expected: bool
    is_closed: bool
    meals: int


@dataclass(frozen=True, slots=True)
class StudyOverview:
    """by_status: the window's meals. waiting, failures: of the whole study, now. places None: the study keeps none.

    waiting also has meals whose after-meal pair is waited for, or has failed, whatever their status. person_days: by
    participant and day; None: they would be more than MOST_PERSONS, or more than MOST_DAYS_OF_PERSONS.
    """

    study: str
    first_day: date
    last_day: date
    people: PeopleCounts
    completeness: Completeness
    days: tuple[OverviewDay, ...]
    by_status: Mapping[MealStatus, int]
    waiting: Mapping[CountedStatus, int]
    failures: Mapping[str, int]
    nutrients: tuple[Distribution, ...]
    person_days: tuple[DayOfPerson, ...] | None
    places: Places | None


def study_overview(
    database: Database,
    caller: Caller,
    study_code: str,
    *,
    first_day: date | None = None,
    last_day: date | None = None,
    days: int | None = USUAL_DAYS,
    binned: str | None = None,
    now: datetime | None = None,
) -> StudyOverview:
    """The overview from first_day to last_day, both included; of an end that is not given see `_window`.

    days: how long the window is where first_day is not given; None: from the first day that anything is known of.
    binned: the only headline column whose bins are counted; None: all.

    Raises NotFoundError, InvalidInputError (`days_reversed`, `days_too_many`).
    """
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        today = latest_day(now or datetime.now(UTC))
        latest = overview.last_day_of(session, study.id, today) if last_day is None else None
        first, last = _window(first_day, last_day, latest or today, days)
        if days is None and first_day is None:
            first = min(max(first, overview.first_day_of(session, study.id) or first), last)
        window = overview.Window(session, study.id, first, last)
        counted = window.days()
        everybody = window.people()
        is_small = everybody.everybody <= MOST_PERSONS and (last - first).days < MOST_DAYS_OF_PERSONS
        shown = _with_silence(counted, window.spans(), first, last, today)
        return StudyOverview(
            study=study.code,
            first_day=first,
            last_day=last,
            people=everybody,
            completeness=_completeness(shown, Runs.of(day.delays for day in counted)),
            days=shown,
            by_status={status: sum(day.counts.by_status[status] for day in counted) for status in MEAL_STATUSES},
            waiting=overview.waiting_of(session, study.id),
            failures=overview.failures_of(session, study.id),
            nutrients=tuple(
                distribution(name, (day.amounts[name] for day in counted), binned=binned in (None, name))
                for name in HEADLINE_COLUMNS
            ),
            person_days=tuple(_days_of_persons(window, first, last, today)) if is_small else None,
            places=_places(window, study, sum(day.counts.located_meals for day in counted)),
        )


def study_waiting(
    database: Database, caller: Caller, study_code: str
) -> tuple[dict[CountedStatus, int], dict[str, int]]:
    """(waiting, failures) of an overview at this moment. Raises NotFoundError."""
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        return overview.waiting_of(session, study.id), overview.failures_of(session, study.id)


def note_overview_export(database: Database, caller: StaffCaller, study_code: str, part: str, output: str) -> None:
    """Who took a table of an overview away, in the study's log. Raises NotFoundError."""
    with database.write() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError("There is no such study.")
        audit.note(session, caller, "overview.export", study_id=study.id, output=output, part=part)


def _window(
    first_day: date | None, last_day: date | None, latest: date, days: int | None = USUAL_DAYS
) -> tuple[date, date]:
    """The window. Without `to` it ends with the last day that anything is known of, but never before it begins.

    Without `from` it has so many days; None: as many as it may have.
    """
    if last_day is None:
        last_day = latest if first_day is None else max(first_day, latest)
        if first_day is not None and (last_day - first_day).days >= MAX_RANGE_DAYS:
            last_day = first_day + timedelta(days=MAX_RANGE_DAYS - 1)
    if first_day is None:
        first_day = date.fromordinal(max(last_day.toordinal() - (days or MAX_RANGE_DAYS) + 1, 1))
    require_order(first_day, last_day)
    if (last_day - first_day).days >= MAX_RANGE_DAYS:
        raise InvalidInputError(
            f"At most {MAX_RANGE_DAYS} days at once.", code="days_too_many", limit_days=MAX_RANGE_DAYS
        )
    return first_day, last_day


def _with_silence(
    counted: Sequence[CountedDay],
    spans: Sequence[Span],
    first: date,
    last: date,
    today: date,
) -> tuple[OverviewDay, ...]:
    """Every day of the window, those of which nothing is known too, with how many people's days were expected."""
    days = (last - first).days + 1
    steps = [0] * (days + 1)  # how many more are expected on a day than on the one before
    for span in spans:
        end = min(last, today, span.withdrawn_at.astimezone(UTC).date() if span.withdrawn_at is not None else last)
        if span.first_day <= end:
            steps[(span.first_day - first).days] += span.participants
            steps[(end - first).days + 1] -= span.participants
    known = {day.counts.local_date: day for day in counted}
    found, expected = [], 0
    for number in range(days):
        local_date = first + timedelta(days=number)
        expected += steps[number]
        day = known.get(local_date)
        counts = day.counts if day is not None else _nothing_on(local_date)
        if local_date > today:  # a phone's clock that is ahead: nobody is expected yet
            counts = replace(counts, told=0, told_closed=0)
        seconds = day.delays.median if day is not None and len(day.delays) else None
        found.append(OverviewDay(counts, expected, max(expected - counts.told, 0), seconds))
    return tuple(found)


def _days_of_persons(window: overview.Window, first: date, last: date, today: date) -> Iterator[DayOfPerson]:
    """Each participant's days, expected as `_with_silence` counts them."""
    known = {(day.code, day.local_date): day for day in window.person_days()}
    for person in window.persons():
        left = person.withdrawn_at.astimezone(UTC).date() if person.withdrawn_at is not None else last
        end = min(last, today, left)
        for number in range((last - first).days + 1):
            on = first + timedelta(days=number)
            is_expected = person.first_day is not None and person.first_day <= on <= end
            day = known.get((person.code, on))
            if is_expected or day is not None:
                is_closed, meals = (day.is_closed, day.meals) if day is not None else (False, 0)
                yield DayOfPerson(person.code, on, is_expected, is_closed, meals)


def _nothing_on(local_date: date) -> DayCounts:
    return DayCounts(
        local_date=local_date,
        told=0,
        told_closed=0,
        with_meal=0,
        closed=0,
        ate_nothing=0,
        whole=0,
        whole_energy_kcal=None,
        open_days=0,
        open_energy_kcal=None,
        meals=0,
        by_status=dict.fromkeys(MEAL_STATUSES, 0),
        late_meals=0,
        located_meals=0,
        unmeasured_meals=0,
        items=0,
        unmeasured_items=0,
        provisional_items=0,
    )


def _completeness(days: Sequence[OverviewDay], delays: Runs) -> Completeness:
    return Completeness(
        expected=sum(day.expected for day in days),
        told=sum(day.counts.told for day in days),
        closed=sum(day.counts.closed for day in days),
        whole=sum(day.counts.whole for day in days),
        silent=sum(day.silent for day in days),
        meals=sum(day.counts.meals for day in days),
        late_meals=sum(day.counts.late_meals for day in days),
        median_delay_seconds=delays.median if len(delays) else None,
    )


def _places(window: overview.Window, study: Study, total: int) -> Places | None:
    if study.location_policy == "drop":  # what an earlier policy kept is not shown either
        return None
    shown = window.places(min(total, MOST_PLACES)) if total else []
    return Places(
        total,
        tuple(
            place._replace(
                latitude=round(place.latitude, SHOWN_DECIMALS), longitude=round(place.longitude, SHOWN_DECIMALS)
            )
            for place in shown
        ),
    )
