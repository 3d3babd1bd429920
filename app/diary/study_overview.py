"""A study's overview over a window of local days: participants, days, waiting meals, nutrients, places.

All figures come from one read transaction. Unknown values are None, never 0. Means and distributions are over whole
days (closed and measured and final, or nothing eaten) and give the number of days.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, date, datetime, timedelta

from app.core.errors import NotFoundError
from app.db.session import Database
from app.db.sorted_values import Runs
from app.diary import overview_queries as overview
from app.diary.diary import MAX_RANGE_DAYS, day_range
from app.diary.distribution import NO_VALUES, Bin, Distribution, distribution
from app.diary.overview_queries import CountedStatus, PeopleCounts, Place, Span
from app.diary.study_day_sum_queries import CountedDay, DayCounts
from app.meals.meal_time import latest_day
from app.meals.models import MEAL_STATUSES, MealStatus
from app.meals.record_models import HEADLINE_COLUMNS
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import Caller, StaffCaller
from app.people.studies import enter_study

DEFAULT_DAYS = 28
MAX_PLACES = 2000
MAX_PERSONS = 60  # whose days are listed one by one
MAX_DAYS_OF_PERSONS = 35
MAX_WHOLE_DAYS = 30_000  # of which each participant's means are computed: of more it takes longer than a page may
COUNT_FIELDS = tuple(field.name for field in fields(DayCounts))
SHOWN_DECIMALS = 3  # of degrees: about a hundred metres, finer than a map of a study shows


@dataclass(frozen=True, slots=True, kw_only=True)
class OverviewDay(DayCounts):
    """A local day of the window. expected: participants expected on the day; silent: of them, without an entry.

    median_delay_seconds: from eating to arrival, of the day's meals.
    """

    expected: int
    silent: int
    median_delay_seconds: float | None


@dataclass(frozen=True, slots=True)
class Completeness:
    """Participant-days of the window. told: with a meal or closed; silent: expected, without either.

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
class DayOfPerson:
    """A participant's day of the window that was expected, or has a meal or a diary entry."""

    participant: str
    local_date: date
    expected: bool
    closed: bool
    meals: int


@dataclass(frozen=True, slots=True)
class StudyOverview:
    """A study's overview. statuses: of the window's meals. waiting, failures: of the whole study, now.

    waiting also counts meals whose after-meal pair is pending or has failed, in any status. person_days: by participant
    and day; empty if there are more than MAX_PERSONS or MAX_DAYS_OF_PERSONS. located_meals: of the window; None if the
    study keeps no places. places: the newest, rounded to SHOWN_DECIMALS.
    """

    study: str
    first_day: date
    last_day: date
    participants: PeopleCounts
    completeness: Completeness
    days: tuple[OverviewDay, ...]
    statuses: Mapping[MealStatus, int]
    waiting: Mapping[CountedStatus, int]
    failures: Mapping[str, int]
    nutrients: tuple[Distribution, ...]
    person_days: tuple[DayOfPerson, ...]
    located_meals: int | None
    places: tuple[Place, ...]

    @property
    def histograms(self) -> list[Bin]:
        """The bins of all components, in order."""
        return [histogram_bin for nutrient in self.nutrients for histogram_bin in nutrient.bins()]


def study_overview(
    database: Database,
    caller: Caller,
    study_code: str,
    *,
    first_day: date | None = None,
    last_day: date | None = None,
    days: int | None = DEFAULT_DAYS,
    binned: str | None = None,
    now: datetime | None = None,
) -> StudyOverview:
    """Return the overview from first_day to last_day, both included.

    Without last_day the window ends with the last day that has a meal or a diary entry, but not before first_day.

    days: length of the window without first_day; None: from the first day with data. binned: the headline column to
    count bins of; None: all.

    Raises NotFoundError, InvalidInputError (`days_reversed`, `days_too_many`).
    """
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        today = latest_day(now or datetime.now(UTC))
        latest = overview.last_day_of(session, study.id, today) if last_day is None else None
        first, last = day_range(first_day, last_day, latest or today, days or MAX_RANGE_DAYS)
        if days is None and first_day is None:
            first = min(max(first, overview.first_day_of(session, study.id) or first), last)
        window = overview.Window(session, study.id, first, last)
        counted = window.days()
        people_counts = window.people()
        is_small = people_counts.everybody <= MAX_PERSONS and (last - first).days < MAX_DAYS_OF_PERSONS
        whole_days = sum(day.counts.whole for day in counted)
        person_means = window.means_of_persons() if whole_days <= MAX_WHOLE_DAYS else {}
        shown = _overview_days(counted, window.spans(), first, last, today)
        keeps_places = study.location_policy != "drop"  # places kept under an earlier policy are not shown either
        located_meals = sum(day.located_meals for day in shown)
        return StudyOverview(
            study=study.code,
            first_day=first,
            last_day=last,
            participants=people_counts,
            completeness=_completeness(shown, Runs.of(day.delays for day in counted)),
            days=shown,
            statuses={status: sum(getattr(day, f"{status}_meals") for day in shown) for status in MEAL_STATUSES},
            waiting=overview.count_waiting(session, study.id),
            failures=overview.count_failures(session, study.id),
            nutrients=tuple(
                distribution(
                    name,
                    (day.amounts[name] for day in counted),
                    person_means.get(name, NO_VALUES),
                    binned=binned in (None, name),
                )
                for name in HEADLINE_COLUMNS
            ),
            person_days=tuple(_days_of_persons(window, first, last, today)) if is_small else (),
            located_meals=located_meals if keeps_places else None,
            places=_places(window, min(located_meals, MAX_PLACES)) if keeps_places and located_meals else (),
        )


def study_waiting(
    database: Database, caller: Caller, study_code: str
) -> tuple[dict[CountedStatus, int], dict[str, int]]:
    """Return (waiting, failures) of a study's overview. Raises NotFoundError."""
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        return overview.count_waiting(session, study.id), overview.count_failures(session, study.id)


def note_overview_export(database: Database, caller: StaffCaller, study_code: str, part: str, output: str) -> None:
    """Note in the audit log who downloaded a table of an overview. Raises NotFoundError."""
    with database.write() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError("There is no such study.")
        audit.note(session, caller, "overview.export", study_id=study.id, output=output, part=part)


def _overview_days(
    counted: Sequence[CountedDay],
    spans: Sequence[Span],
    first: date,
    last: date,
    today: date,
) -> tuple[OverviewDay, ...]:
    """Return every day of the window, also those without data, with the number of participants expected."""
    days = (last - first).days + 1
    steps = [0] * (days + 1)  # change of the number expected from the day before
    for span in spans:
        end = _last_expected(span.withdrawn_at, last, today)
        if span.first_day <= end:
            steps[(span.first_day - first).days] += span.participants
            steps[(end - first).days + 1] -= span.participants
    counted_by_date = {day.counts.local_date: day for day in counted}
    shown, expected = [], 0
    for number in range(days):
        local_date = first + timedelta(days=number)
        expected += steps[number]
        day = counted_by_date.get(local_date)
        counts = day.counts if day is not None else DayCounts(local_date=local_date)
        if local_date > today:  # from a phone whose clock is ahead: nobody is expected yet
            counts = replace(counts, told=0, told_closed=0)
        seconds = day.delays.median if day is not None and len(day.delays) else None
        shown.append(
            OverviewDay(
                **{name: getattr(counts, name) for name in COUNT_FIELDS},
                expected=expected,
                silent=max(expected - counts.told, 0),
                median_delay_seconds=seconds,
            )
        )
    return tuple(shown)


def _days_of_persons(window: overview.Window, first: date, last: date, today: date) -> Iterator[DayOfPerson]:
    """Yield each participant's days; expected days are those that `_overview_days` counts."""
    person_days = {(day.code, day.local_date): day for day in window.person_days()}
    for person in window.persons():
        end = _last_expected(person.withdrawn_at, last, today)
        for number in range((last - first).days + 1):
            local_date = first + timedelta(days=number)
            is_expected = person.first_day is not None and person.first_day <= local_date <= end
            day = person_days.get((person.code, local_date))
            if is_expected or day is not None:
                is_closed, meals = (day.is_closed, day.meals) if day is not None else (False, 0)
                yield DayOfPerson(person.code, local_date, is_expected, is_closed, meals)


def _completeness(days: Sequence[OverviewDay], delays: Runs) -> Completeness:
    return Completeness(
        expected=sum(day.expected for day in days),
        told=sum(day.told for day in days),
        closed=sum(day.closed for day in days),
        whole=sum(day.whole for day in days),
        silent=sum(day.silent for day in days),
        meals=sum(day.meals for day in days),
        late_meals=sum(day.late_meals for day in days),
        median_delay_seconds=delays.median if len(delays) else None,
    )


def _places(window: overview.Window, limit: int) -> tuple[Place, ...]:
    return tuple(
        place._replace(latitude=round(place.latitude, SHOWN_DECIMALS), longitude=round(place.longitude, SHOWN_DECIMALS))
        for place in window.places(limit)
    )


def _last_expected(withdrawn_at: datetime | None, last: date, today: date) -> date:
    """Return the last day of the window expected of a participant. withdrawn_at: None if they have not left."""
    return min(last, today, withdrawn_at.astimezone(UTC).date() if withdrawn_at is not None else last)
