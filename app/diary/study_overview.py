"""A study's overview over a window of local days: participants, days, waiting meals, nutrients, places.

All figures come from one read transaction. Unknown values are None, never 0. Means and
distributions are over whole days (closed and measured and final, or nothing eaten) and give the
number of days.
"""

import uuid
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from statistics import fmean

from app.core.errors import NotFoundError
from app.db.session import Database
from app.diary import overview_queries as overview
from app.diary.day_definition import PLACES, CountedDay, median_or_none
from app.diary.diary import MAX_RANGE_DAYS, day_range
from app.diary.distribution import Bin, Distribution, distribution
from app.diary.overview_queries import MealsOfDay, Person
from app.diary.overview_schemas import (
    CompletenessOut,
    CountedStatus,
    OverviewDayOut,
    OverviewPeopleOut,
    PersonDayOut,
    PlaceOut,
)
from app.meals.stored.meal_time import latest_day
from app.meals.stored.models import MEAL_STATUSES, MealStatus
from app.nutrition.components import HEADLINE_COLUMNS
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import Caller, StaffCaller
from app.people.studies import enter_study

DEFAULT_DAYS = 28
MAX_PLACES = 2000
MAX_PERSONS = 60  # whose days are listed one by one
MAX_DAYS_OF_PERSONS = 35
WholeDay = tuple[CountedDay, Sequence[float | None]]  # its amounts by HEADLINE_COLUMNS
NO_MEALS = MealsOfDay(dict.fromkeys(MEAL_STATUSES, 0), 0, 0, [])


@dataclass(frozen=True, slots=True)
class StudyOverview:
    """A study's overview.

    statuses: of the window's meals
    waiting, failures: of the whole study, now

    waiting also counts meals whose after-meal pair is pending or has failed, in any status.
    person_days: by participant and day; empty if there are more than MAX_PERSONS or
    MAX_DAYS_OF_PERSONS. located_meals: of the window; None if the study keeps no places. places:
    the newest, rounded to SHOWN_DECIMALS.
    """

    study: str
    first_day: date
    last_day: date
    participants: OverviewPeopleOut
    completeness: CompletenessOut
    days: tuple[OverviewDayOut, ...]
    statuses: Mapping[MealStatus, int]
    waiting: Mapping[CountedStatus, int]
    failures: Mapping[str, int]
    nutrients: tuple[Distribution, ...]
    person_days: tuple[PersonDayOut, ...]
    located_meals: int | None
    places: Sequence[PlaceOut]

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

    Without last_day the window ends with the last day that has a meal or a diary entry, but not
    before first_day.

    days: length of the window without first_day; None: from the first day with data
    binned: the headline column to count bins of; None: all

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
        counted, meals = window.days(), window.meals()
        persons = window.persons(counted)
        people_counts = _people(
            persons, counted, privacy.count_erased_participants(session, study.id)
        )
        is_small = (
            people_counts.everybody <= MAX_PERSONS and (last - first).days < MAX_DAYS_OF_PERSONS
        )
        whole_days = [(day, day.whole_amounts()) for day in counted if day.is_complete]
        amounts, person_means = _amounts(whole_days)
        shown = _overview_days(counted, whole_days, meals, persons, _days_until(first, last), today)
        # places kept under an earlier policy are not shown either
        keeps_places = study.location_policy != "drop"
        located_meals = sum(day.located_meals for day in shown)
        return StudyOverview(
            study=study.code,
            first_day=first,
            last_day=last,
            participants=people_counts,
            completeness=_completeness(shown, meals.values()),
            days=shown,
            statuses={
                status: sum(getattr(day, f"{status}_meals") for day in shown)
                for status in MEAL_STATUSES
            },
            waiting=overview.count_waiting(session, study.id),
            failures=overview.count_failures(session, study.id),
            nutrients=tuple(
                distribution(name, amounts[name], person_means[name], binned=binned in (None, name))
                for name in HEADLINE_COLUMNS
            ),
            person_days=tuple(_days_of_persons(counted, persons, _days_until(first, last), today))
            if is_small
            else (),
            located_meals=located_meals if keeps_places else None,
            places=window.places(min(located_meals, MAX_PLACES))
            if keeps_places and located_meals
            else [],
        )


def study_waiting(
    database: Database, caller: Caller, study_code: str
) -> tuple[dict[CountedStatus, int], dict[str, int]]:
    """Return (waiting, failures) of a study's overview. Raises NotFoundError."""
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        return overview.count_waiting(session, study.id), overview.count_failures(session, study.id)


def note_overview_export(
    database: Database, caller: StaffCaller, study_code: str, part: str, output: str
) -> None:
    """Note in the audit log who downloaded a table of an overview. Raises NotFoundError."""
    with database.write() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError("There is no such study.")
        audit.note(session, caller, "overview.export", study_id=study.id, output=output, part=part)


def _people(
    persons: Sequence[Person], days: Sequence[CountedDay], erased: int
) -> OverviewPeopleOut:
    left = sum(person.withdrawn_at is not None for person in persons)
    return OverviewPeopleOut(
        everybody=len(persons) + erased,
        active=len({day.participant_id for day in days if day.meals}),
        withdrawn=left + erased,
        erased=erased,
    )


def _amounts(
    days: Sequence[WholeDay],
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Return each headline column's known amounts, and each participant's means of them."""
    amounts: dict[str, list[float]] = {name: [] for name in HEADLINE_COLUMNS}
    means: dict[str, list[float]] = {name: [] for name in HEADLINE_COLUMNS}
    days_of: dict[uuid.UUID, list[Sequence[float | None]]] = defaultdict(list)
    for day, amounts_of_day in days:
        days_of[day.participant_id].append(amounts_of_day)
    for person_days in days_of.values():
        for name, column in zip(HEADLINE_COLUMNS, zip(*person_days, strict=True), strict=True):
            known = [amount for amount in column if amount is not None]
            amounts[name] += known
            if known:
                means[name].append(fmean(known))
    return amounts, means


def _overview_days(
    counted: Sequence[CountedDay],
    whole_days: Sequence[WholeDay],
    meals: Mapping[date, MealsOfDay],
    persons: Sequence[Person],
    window: Sequence[date],
    today: date,
) -> tuple[OverviewDayOut, ...]:
    """Return every day of the window, also those without data."""
    person_of = {person.id: person for person in persons}
    days_of: dict[date, list[CountedDay]] = defaultdict(list)
    for day in counted:
        days_of[day.local_date].append(day)
    whole_kcal: dict[date, list[float]] = defaultdict(list)
    for day, amounts in whole_days:
        kcal = amounts[PLACES["energy_kcal"]]
        if kcal is not None:
            whole_kcal[day.local_date].append(kcal)
    expected = _expected(persons, window, today)
    return tuple(
        _overview_day(
            local_date,
            days_of[local_date],
            whole_kcal[local_date],
            meals.get(local_date, NO_MEALS),
            expected[local_date],
            person_of,
        )
        for local_date in window
    )


def _overview_day(
    local_date: date,
    days: Sequence[CountedDay],
    whole_kcal: Sequence[float],
    meals: MealsOfDay,
    expected: int | None,
    person_of: Mapping[uuid.UUID, Person],
) -> OverviewDayOut:
    """expected: the number of participants expected; None: in the future, from a phone whose clock is ahead."""
    told = [
        day
        for day in days
        if expected is not None
        and (day.meals or day.is_closed)
        and _could_tell(person_of[day.participant_id], day)
    ]
    closed = [day for day in days if day.is_closed]
    open_amounts = [day.amount("energy_kcal").value for day in days if not day.is_closed]
    open_kcal = [amount for amount in open_amounts if amount is not None]
    statuses = {f"{status}_meals": count for status, count in meals.statuses.items()}
    told_closed = sum(day.is_closed for day in told)
    all_meals = sum(meals.statuses.values())
    return OverviewDayOut(
        local_date=local_date,
        expected=expected or 0,
        silent=max((expected or 0) - len(told), 0),
        told=len(told),
        told_closed=told_closed,
        told_open=len(told) - told_closed,
        with_meal=sum(day.meals > 0 for day in days),
        closed=len(closed),
        ate_nothing=sum(day.ate_nothing for day in closed),
        whole=len(whole_kcal),
        whole_energy_kcal=fmean(whole_kcal) if whole_kcal else None,
        open_days=len(open_kcal),
        open_energy_kcal=fmean(open_kcal) if open_kcal else None,
        meals=all_meals,
        late_meals=meals.late,
        late_share=meals.late / all_meals if all_meals else None,
        located_meals=meals.located,
        unmeasured_meals=sum(day.unmeasured_meals for day in days),
        items=sum(day.items for day in days),
        unmeasured_items=sum(day.unmeasured_items for day in days),
        provisional_items=sum(day.provisional_items for day in days),
        median_delay_seconds=median_or_none(meals.delays),
        **statuses,
    )


def _could_tell(person: Person, day: CountedDay) -> bool:
    """Whether the day is between the participant's start, if one is set, and the day on which they left."""
    has_begun = person.starts_on is None or person.starts_on <= day.local_date
    return has_begun and (
        person.withdrawn_at is None or _left_on(person.withdrawn_at) >= day.local_date
    )


def _expected(
    persons: Sequence[Person], window: Sequence[date], today: date
) -> dict[date, int | None]:
    """Return the number of participants expected on each day; None: in the future."""
    changes: dict[date, int] = defaultdict(int)  # from the day before
    for person in persons:
        begin, end = expected_span(person, window[0], window[-1], today)
        if begin <= end:
            changes[begin] += 1
            if end < window[-1]:
                changes[end + timedelta(days=1)] -= 1
    expected: dict[date, int | None] = {}
    number = 0
    for local_date in window:
        number += changes[local_date]
        expected[local_date] = number if local_date <= today else None
    return expected


def _days_of_persons(
    counted: Sequence[CountedDay], persons: Sequence[Person], window: Sequence[date], today: date
) -> Iterator[PersonDayOut]:
    """Yield each participant's days; expected days are those that `_overview_days` counts."""
    day_of = {(day.participant_id, day.local_date): day for day in counted}
    for person in persons:
        begin, end = expected_span(person, window[0], window[-1], today)
        for local_date in window:
            is_expected = begin <= local_date <= end
            day = day_of.get((person.id, local_date))
            if is_expected or day is not None:
                is_closed, meals = (day.is_closed, day.meals) if day is not None else (False, 0)
                yield PersonDayOut(
                    participant=person.code,
                    local_date=local_date,
                    expected=is_expected,
                    closed=is_closed,
                    meals=meals,
                )


def _completeness(days: Sequence[OverviewDayOut], meals: Iterable[MealsOfDay]) -> CompletenessOut:
    delays = [delay for day in meals for delay in day.delays]
    return CompletenessOut(
        expected=sum(day.expected for day in days),
        told=sum(day.told for day in days),
        closed=sum(day.closed for day in days),
        whole=sum(day.whole for day in days),
        silent=sum(day.silent for day in days),
        meals=sum(day.meals for day in days),
        late_meals=sum(day.late_meals for day in days),
        median_delay_seconds=median_or_none(delays),
    )


def _days_until(first: date, last: date) -> list[date]:
    return [first + timedelta(days=number) for number in range((last - first).days + 1)]


def expected_span(person: Person, first: date, last: date, today: date) -> tuple[date, date]:
    """Return the first and the last day of a window expected of a participant; reversed if none is."""
    left_on = last if person.withdrawn_at is None else _left_on(person.withdrawn_at)
    return max(person.first_day or date.max, first), min(last, today, left_on)


def _left_on(withdrawn_at: datetime) -> date:
    return withdrawn_at.astimezone(UTC).date()
