"""What a participant may see of what they ate: a day's amounts, and from three closed days on a careful comparison.

Off unless the study gives feedback, since it changes what people eat. A day shows amounts only: a day above or below a
recommendation says nothing. Staff see the same of any participant of theirs.
"""

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta
from typing import Literal

from sqlalchemy.orm import Session

from app.db.models import EffectiveRecord, Participant, Study
from app.db.models.people import Locale
from app.db.models.record import HEADLINE_COLUMNS
from app.db.queries import days, diary
from app.db.queries.day_definition import FULL
from app.db.queries.days import DayFilter, DayRow
from app.db.queries.eaten import meals_of_day
from app.db.session import Database
from app.errors import InvalidInputError, NotAllowedError
from app.nutrition.compare_intake import MIN_DAYS, Comparison, Kind, compare_intake
from app.nutrition.life_stage import LifeStage, life_stage
from app.nutrition.nutrients import NOTHING, interval_in_proportion
from app.nutrition.reference_intakes import reference_intakes
from app.services.caller import Caller, DeviceCaller
from app.services.diary import Whose, find_participant
from app.services.food_amounts import RECORD_COLUMNS
from app.services.messages.feedback_sentences import feedback_sentence, locale_of
from app.services.record_amounts import eaten_g
from app.services.study_days import StudyDay, number_days, person_on

WINDOW_DAYS = 14  # two weeks: each weekday twice
COMPARED = ("protein_g", "fibre_g", "sodium_mg", "potassium_mg", "vitamin_c_mg")  # what a reference compares with as is

NoComparison = Literal["days_needed", "profile_needed"]


@dataclass(frozen=True, slots=True)
class EatenAmount:
    """An amount in its column's unit. None: known of nothing. low, high: at least 90 %; None where they are not known.

    coverage: the share of the grams for which it is known; None where grams are not known.
    """

    value: float | None
    low: float | None
    high: float | None
    coverage: float | None


@dataclass(frozen=True, slots=True)
class EatenMeal:
    """One meal of the day, by the phone's id."""

    client_id: uuid.UUID
    captured_at: datetime
    items: int
    unmeasured_items: int
    amounts: Mapping[str, EatenAmount]


@dataclass(frozen=True, slots=True)
class CompareDays:
    """What the comparison rests on: closed days of the window, those of them that are measured whole and final.

    why_not: why nothing is compared.
    """

    window_days: int
    closed_days: int
    whole_days: int
    found: Mapping[str, Comparison]
    coverage: Mapping[str, float]  # the mean of the days'
    why_not: NoComparison | None = None


@dataclass(frozen=True, slots=True)
class Feedback:
    """A day's feedback; day None: nothing is known of the day."""

    local_date: date
    day: StudyDay | None
    meals: tuple[EatenMeal, ...]
    amounts: Mapping[str, EatenAmount]
    unmeasured_meals: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    comparison: CompareDays
    locale: Locale
    sentences: tuple[str, ...]
    disclaimer: str


def read_feedback(database: Database, caller: Caller, local_date: date | None, whose: Whose | None = None) -> Feedback:
    """A day's feedback; without a date, of the last day that has a meal or a word.

    Raises NotAllowedError (`feedback_off`) for a phone whose study gives none, InvalidInputError where there is no day
    yet, NotFoundError.
    """
    with database.read() as session:
        participant = find_participant(session, caller, whose)
        study = session.get_one(Study, participant.study_id)
        if isinstance(caller, DeviceCaller) and not study.gives_feedback:
            raise NotAllowedError("This study gives no feedback while it measures.", code="feedback_off")
        day = local_date or diary.latest_day_of(session, participant.id)
        if day is None:
            raise InvalidInputError("There is no day with a meal yet: name a date.", code="no_day_yet")
        return _feedback(session, participant, study, day)


def compare_days(rows: Sequence[DayRow], stage: LifeStage | None) -> CompareDays:
    """Compare a window's days with the reference intakes of a life stage; stage None: it is not known."""
    closed = [row for row in rows if row.status == "closed"]
    whole = [row for row in closed if row.is_complete]
    why_not: NoComparison | None = "days_needed" if len(whole) < MIN_DAYS else None
    if stage is None and why_not is None:
        why_not = "profile_needed"
    found: dict[str, Comparison] = {}
    coverages: dict[str, float] = {}
    references = _references(stage) if stage is not None and why_not is None else {}
    for column, (reference, kind) in references.items():
        amounts = [row.amount(column) for row in whole]
        known = [(each.value, each.coverage or 0.0) for each in amounts if each.value is not None]
        if len(known) < MIN_DAYS:
            continue
        coverages[column] = sum(share for _, share in known) / len(known)
        is_covered = len(known) == len(whole) and all(share >= FULL for _, share in known)
        daily = [max(value, 0.0) for value, _ in known]
        found[column] = compare_intake(daily, reference, kind, is_covered=is_covered)
    return CompareDays(WINDOW_DAYS, len(closed), len(whole), found, coverages, why_not)


def sum_amounts(records: Iterable[EffectiveRecord], *, is_all: bool = True) -> dict[str, EatenAmount]:
    """Column -> the sum over records, with an interval that holds whatever the items' errors share.

    Each end is the sum of the items' ends, as if all erred alike: wider than it need be, never narrower.
    is_all: False where something was eaten of which there is no record.
    """
    eaten = list(records)
    sums = {column: _sum(eaten, column) for column in HEADLINE_COLUMNS}
    return sums if is_all else {column: replace(found, coverage=None) for column, found in sums.items()}


def _feedback(session: Session, participant: Participant, study: Study, day: date) -> Feedback:
    rows = days.days_of(session, DayFilter(participant_id=participant.id, first_day=_window_start(day), last_day=day))
    today = next((row for row in rows if row.local_date == day), None)
    eaten = meals_of_day(session, participant.id, day)
    every = [record for _, records in eaten for record in records]
    unmeasured_meals = today.unmeasured_meals if today is not None else 0
    unmeasured = sum(record.consumed_g is None for record in every)
    provisional = sum(record.provisional for record in every)
    is_nothing = today is not None and today.is_nothing
    amounts = sum_amounts(every, is_all=unmeasured_meals == 0)
    if is_nothing:
        amounts = dict.fromkeys(HEADLINE_COLUMNS, EatenAmount(0.0, 0.0, 0.0, 1.0))
    comparison = compare_days(rows, _stage_on(participant, day))
    locale = locale_of(study.locale)
    sentences = [
        *_sentences_of_day(locale, day, today, len(eaten), amounts["energy_kcal"], unmeasured),
        *_sentences_of_what_is_open(locale, today, provisional),
        *_sentences_of_comparison(locale, comparison),
    ]
    return Feedback(
        local_date=day,
        day=number_days(session, [today])[0] if today is not None else None,
        meals=tuple(
            EatenMeal(
                meal.client_id,
                meal.captured_at,
                len(records),
                sum(record.consumed_g is None for record in records),
                sum_amounts(records),
            )
            for meal, records in eaten
        ),
        amounts=amounts,
        unmeasured_meals=unmeasured_meals,
        unmeasured_items=unmeasured,
        provisional_items=provisional,
        leftovers_unknown_items=today.leftovers_unknown_items if today is not None else 0,
        comparison=comparison,
        locale=locale,
        sentences=tuple(sentences),
        disclaimer=feedback_sentence("not_advice", locale),
    )


def _sum(eaten: Sequence[EffectiveRecord], column: str) -> EatenAmount:
    known = [(getattr(record, column), record) for record in eaten if getattr(record, column) is not None]
    if not known:
        return EatenAmount(None, None, None, None)
    value = sum(amount for amount, _ in known)
    ends = [_ends(amount, record) for amount, record in known]
    low = high = None
    if all(each is not None for each in ends):
        low = max(sum(each[0] for each in ends if each is not None), 0.0)
        high = max(sum(each[1] for each in ends if each is not None), 0.0)
        if low == high == 0.0 and not all(eaten_g(record) == NOTHING for _, record in known):
            low = high = None  # the table's 0 of all that was eaten, of which the grams' doubt tells nothing
    grams = [(max(record.consumed_g, 0.0), record) for record in eaten if record.consumed_g is not None]
    whole_g = sum(gram for gram, _ in grams)
    coverage = None
    if len(grams) == len(eaten):
        known_g = sum(gram for gram, record in grams if getattr(record, column) is not None)
        coverage = known_g / whole_g if whole_g > 0.0 else float(len(known) == len(eaten))
    return EatenAmount(max(value, 0.0), low, high, coverage)


def _ends(amount: float, record: EffectiveRecord) -> tuple[float, float] | None:
    """The amount at the ends of the grams' interval; of a food that has none of it, 0: it adds nothing to a sum."""
    grams = eaten_g(record)
    if grams is None:
        return None
    is_free_of_it = amount == 0.0 and grams.value != 0.0
    return (0.0, 0.0) if is_free_of_it else interval_in_proportion(amount, grams)


def _references(stage: LifeStage) -> dict[str, tuple[float, Kind]]:
    """Column -> what it is compared with, and of which kind that is; the CDRR before an AI, the RDA before both."""
    by_number = {intake.number: intake for intake in reference_intakes(stage) if intake.per == "day"}
    found: dict[str, tuple[float, Kind]] = {}
    for column in COMPARED:
        intake = by_number.get(RECORD_COLUMNS[column][0])
        if intake is None:
            continue
        kinds: tuple[tuple[float | None, Kind], ...] = (
            (intake.cdrr, "cdrr"),
            (intake.rda, "rda"),
            (intake.ai, "ai"),
        )
        known = [(figure, kind) for figure, kind in kinds if figure is not None]
        if known:
            found[column] = known[0]
    return found


def _stage_on(participant: Participant, day: date) -> LifeStage | None:
    person = person_on(participant.profile, day)
    if person is None:
        return None
    try:
        return life_stage(
            person.age_years,
            person.known_sex,
            is_pregnant=person.is_pregnant,
            is_lactating=person.is_lactating,
        )
    except ValueError:  # no column without the sex
        return None


def _window_start(day: date) -> date:
    return day - min(timedelta(days=WINDOW_DAYS - 1), day - date.min)


def _sentences_of_day(
    locale: Locale,
    day: date,
    today: DayRow | None,
    meals: int,
    energy: EatenAmount,
    unmeasured: int,
) -> Iterable[str]:
    if today is not None and today.ate_nothing:
        yield feedback_sentence("nothing_eaten", locale, day=day)
        return
    if energy.value is None:
        yield feedback_sentence("day_without_energy", locale, day=day, meals=meals)
    else:
        yield feedback_sentence("day", locale, day=day, meals=meals, energy=_rounded(energy.value))
    if energy.low is not None and energy.high is not None and energy.high > 0.0:
        yield feedback_sentence("energy_interval", locale, low=_rounded(energy.low), high=_rounded(energy.high))
    if unmeasured:
        yield feedback_sentence("unmeasured", locale, count=unmeasured)
    if today is not None and today.unmeasured_meals:
        yield feedback_sentence("unmeasured_meals", locale, count=today.unmeasured_meals)
    if today is not None and today.leftovers_unknown_items:
        yield feedback_sentence("leftovers_unknown", locale, count=today.leftovers_unknown_items)


def _sentences_of_what_is_open(locale: Locale, today: DayRow | None, provisional: int) -> Iterable[str]:
    if provisional:
        yield feedback_sentence("provisional", locale)
    if today is None or today.status == "open":
        yield feedback_sentence("day_open", locale)


def _sentences_of_comparison(locale: Locale, comparison: CompareDays) -> Iterable[str]:
    if comparison.why_not == "profile_needed":
        yield feedback_sentence("profile_needed", locale)
        return
    if comparison.why_not == "days_needed":
        yield feedback_sentence("days_needed", locale, needed=MIN_DAYS, window=WINDOW_DAYS, days=comparison.whole_days)
        return
    yield feedback_sentence("basis", locale, days=comparison.closed_days, window=WINDOW_DAYS)
    if comparison.whole_days < comparison.closed_days:
        yield feedback_sentence("basis_unmeasured", locale, count=comparison.closed_days - comparison.whole_days)
    for column, found in comparison.found.items():
        yield feedback_sentence(
            found.verdict,
            locale,
            name=feedback_sentence(f"name_{column}", locale),
            unit=feedback_sentence(f"unit_{column.rpartition('_')[2]}", locale),
            mean=_rounded(found.mean),
            reference=_rounded(found.reference),
        )
    yield feedback_sentence("doubt", locale)


def _rounded(value: float) -> str:
    """Two digits that mean something: an amount from photographs has no more."""
    return f"{float(f'{value:.2g}'):.0f}" if value >= 1.0 else f"{value:.1f}"
