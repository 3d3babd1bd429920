"""A participant's feedback: a day's amounts and, from three closed days on, a comparison with reference intakes.

It is off unless the study gives feedback, since feedback changes what people eat. A single day
shows amounts only: it says nothing about reaching a recommendation. Staff see the same feedback for
participants of their studies.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import date, timedelta

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError, NotAllowedError
from app.core.units import kj_from_kcal
from app.db.session import Database
from app.diary import queries as days
from app.diary.day_definition import FULL
from app.diary.diary import ParticipantRef, find_participant
from app.diary.queries import DayRow
from app.diary.schemas import (
    ComparedOut,
    ComparisonOut,
    EatenAmountOut,
    EatenMealOut,
    NoComparison,
    SummaryOut,
)
from app.diary.study_days import person_on, stage_of
from app.http.row_filter import RowFilter
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.messages.catalogue import feedback_sentence
from app.nutrition.components import HEADLINE_BY_COLUMN, HEADLINE_COLUMNS, HEADLINES
from app.nutrition.intakes.compare_intake import MIN_DAYS, Kind, compare_intake
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import reference_intakes
from app.nutrition.nutrients import NOTHING, interval_in_proportion
from app.people.access.caller import Caller, DeviceCaller
from app.people.models import Participant, Study

WINDOW_DAYS = 14  # two weeks: each weekday twice
COMPARED = tuple(headline for headline in HEADLINES if headline.is_compared)

Sentence = tuple[str, dict[str, object]]  # a sentence's code and its values


def read_feedback(
    database: Database,
    caller: Caller,
    local_date: date | None,
    participant_ref: ParticipantRef | None = None,
) -> SummaryOut:
    """Return a day's feedback; without a date, of the last day that has a meal or a diary entry.

    Raises NotAllowedError (`feedback_off`) for a phone whose study gives no feedback,
    InvalidInputError (`no_day_yet`), NotFoundError.
    """
    with database.read() as session:
        participant = find_participant(session, caller, participant_ref)
        study = session.get_one(Study, participant.study_id)
        if isinstance(caller, DeviceCaller) and not study.gives_feedback:
            raise NotAllowedError(
                "This study gives no feedback while it measures.", code="feedback_off"
            )
        day = local_date or days.latest_day_of(session, participant.id)
        if day is None:
            raise InvalidInputError(
                "There is no day with a meal yet: name a date.", code="no_day_yet"
            )
        return _feedback(session, participant, study, day)


def compare_days(rows: Sequence[DayRow], stage: LifeStage | None) -> ComparisonOut:
    """Compare a window's days with the reference intakes of a life stage; stage None: unknown."""
    closed = [row for row in rows if row.status == "closed"]
    whole = [row for row in closed if row.is_complete]
    compared: dict[str, ComparedOut] = {}
    why_not: NoComparison | None = None
    if len(whole) < MIN_DAYS:
        why_not = "days_needed"
    elif stage is None:
        why_not = "profile_needed"
    else:
        for column, (reference, kind) in _references(stage).items():
            day_amounts = [row.amount(column) for row in whole]
            amounts = [max(amount.value, 0.0) for amount in day_amounts if amount.value is not None]
            coverages = [
                amount.coverage or 0.0 for amount in day_amounts if amount.value is not None
            ]
            if len(amounts) >= MIN_DAYS:
                is_covered = len(amounts) == len(whole) and min(coverages) >= FULL
                comparison = compare_intake(amounts, reference, kind, is_covered=is_covered)
                coverage = sum(coverages) / len(coverages)
                compared[column] = ComparedOut(
                    **asdict(comparison), interval=comparison.interval, coverage=coverage
                )
    return ComparisonOut(
        window_days=WINDOW_DAYS,
        closed_days=len(closed),
        whole_days=len(whole),
        components=compared,
        why_not=why_not,
    )


def sum_amounts(
    records: Iterable[EffectiveRecord], *, is_all: bool = True
) -> dict[str, EatenAmountOut]:
    """Sum records by column, with an interval that is valid however the items' errors are correlated.

    Each end is the sum of the items' ends, as if all errors were fully correlated: the interval may
    be too wide, never too narrow. is_all: False if something was eaten that has no record.
    """
    eaten = list(records)
    sums = {column: _sum(eaten, column) for column in HEADLINE_COLUMNS}
    if not is_all:
        for amount in sums.values():
            amount.coverage = None
    return sums


def _feedback(session: Session, participant: Participant, study: Study, day: date) -> SummaryOut:
    window = RowFilter(participant_id=participant.id, first_day=_window_start(day), last_day=day)
    rows = days.page_of_days(session, window)
    today = next((row for row in rows if row.local_date == day), None)
    meals = days.meals_of_day(session, participant.id, day)
    records = [record for _, meal_records in meals for record in meal_records]
    unmeasured_meals = today.unmeasured_meals if today is not None else 0
    person = person_on(participant.profile, day)
    if today is not None and today.is_nothing:
        nothing = EatenAmountOut(amount=0.0, interval=(0.0, 0.0), coverage=1.0)
        components = dict.fromkeys(HEADLINE_COLUMNS, nothing)
    else:
        components = sum_amounts(records, is_all=unmeasured_meals == 0)
    feedback = SummaryOut(
        date=day,
        study_day=today.study_day if today is not None else None,
        status=today.status if today is not None else "open",
        ate_nothing=today is not None and today.ate_nothing,
        meals=[_eaten_meal(meal, meal_records) for meal, meal_records in meals],
        components=components,
        unmeasured_meals=unmeasured_meals,
        unmeasured_items=sum(record.consumed_g is None for record in records),
        provisional_items=sum(record.provisional for record in records),
        leftovers_unknown_items=today.leftovers_unknown_items if today is not None else 0,
        comparison=compare_days(rows, stage_of(person) if person is not None else None),
        locale=study.locale,
        sentences=[],
        disclaimer=feedback_sentence("not_advice", study.locale),
    )
    for code, values in (*_day_sentences(feedback), *_comparison_sentences(feedback)):
        feedback.sentences.append(feedback_sentence(code, study.locale, **values))
    return feedback


def _eaten_meal(meal: Meal, records: Sequence[EffectiveRecord]) -> EatenMealOut:
    return EatenMealOut(
        meal_id=meal.client_id,
        captured_at=meal.captured_at,
        items=len(records),
        unmeasured_items=sum(record.consumed_g is None for record in records),
        components=sum_amounts(records),
    )


def _sum(eaten: Sequence[EffectiveRecord], column: str) -> EatenAmountOut:
    amounts = [
        (getattr(record, column), record) for record in eaten if getattr(record, column) is not None
    ]
    if not amounts:
        return EatenAmountOut(amount=None, interval=None, coverage=None)
    ends = [_ends(amount, record) for amount, record in amounts]
    interval = None
    if None not in ends:
        low, high = (max(sum(end), 0.0) for end in zip(*filter(None, ends), strict=True))
        if high > 0.0 or all(record.eaten_g == NOTHING for _, record in amounts):
            # otherwise the foods contain none of it, and the grams' interval does not apply
            interval = low, high
    coverage = None
    if all(record.consumed_g is not None for record in eaten):
        whole_g = sum(_positive_g(record) for record in eaten)
        known_g = sum(_positive_g(record) for _, record in amounts)
        coverage = known_g / whole_g if whole_g > 0.0 else float(len(amounts) == len(eaten))
    whole_amount = max(sum(amount for amount, _ in amounts), 0.0)
    return EatenAmountOut(amount=whole_amount, interval=interval, coverage=coverage)


def _positive_g(record: EffectiveRecord) -> float:
    return max(record.consumed_g or 0.0, 0.0)


def _ends(amount: float, record: EffectiveRecord) -> tuple[float, float] | None:
    """Return the amount at the ends of the grams' interval; (0, 0) for a food that contains none of the component."""
    grams = record.eaten_g
    if grams is None:
        return None
    contains_none = amount == 0.0 and grams.value != 0.0
    return (0.0, 0.0) if contains_none else interval_in_proportion(amount, grams)


def _references(stage: LifeStage) -> dict[str, tuple[float, Kind]]:
    """Return each column's reference and its kind: the CDRR if there is one, else the RDA, else the AI."""
    by_number = {
        intake.number: intake for intake in reference_intakes(stage) if intake.per == "day"
    }
    references: dict[str, tuple[float, Kind]] = {}
    for headline in COMPARED:
        intake = by_number.get(headline.numbers[0])
        kinds: tuple[Kind, ...] = ("ai", "rda", "cdrr")
        for kind in kinds:
            figure: float | None = getattr(intake, kind, None)
            if figure is not None:
                references[headline.column] = figure, kind
    return references


def _window_start(day: date) -> date:
    return day - min(timedelta(days=WINDOW_DAYS - 1), day - date.min)


def _day_sentences(feedback: SummaryOut) -> Iterator[Sentence]:
    energy, meals = feedback.components["energy_kcal"], len(feedback.meals)
    if feedback.ate_nothing:
        yield "nothing_eaten", {"day": feedback.date}
    elif energy.amount is None:
        yield "day_without_energy", {"day": feedback.date, "meals": meals}
    else:
        yield "day", {"day": feedback.date, "meals": meals, **_energy("energy", energy.amount)}
    if not feedback.ate_nothing:
        if energy.interval is not None and energy.interval[1] > 0.0:
            low, high = energy.interval
            yield "energy_interval", {**_energy("low", low), **_energy("high", high)}
        counts = {
            "unmeasured": feedback.unmeasured_items,
            "unmeasured_meals": feedback.unmeasured_meals,
            "leftovers_unknown": feedback.leftovers_unknown_items,
        }
        for code, count in counts.items():
            if count:
                yield code, {"count": count}
    if feedback.provisional_items:
        yield "provisional", {}
    if feedback.status == "open":
        yield "day_open", {}


def _comparison_sentences(feedback: SummaryOut) -> Iterator[Sentence]:
    comparison, locale = feedback.comparison, feedback.locale
    if comparison.why_not is not None:
        yield (
            comparison.why_not,
            {"needed": MIN_DAYS, "window": WINDOW_DAYS, "days": comparison.whole_days},
        )
        return
    yield "basis", {"days": comparison.closed_days, "window": WINDOW_DAYS}
    if comparison.whole_days < comparison.closed_days:
        yield "basis_unmeasured", {"count": comparison.closed_days - comparison.whole_days}
    for column, compared in comparison.components.items():
        yield (
            compared.verdict,
            {
                "name": feedback_sentence(f"name_{column}", locale),
                "unit": feedback_sentence(f"unit_{HEADLINE_BY_COLUMN[column].unit}", locale),
                "mean": _rounded(compared.mean),
                "reference": _rounded(compared.reference),
            },
        )
    yield "doubt", {}


def _energy(name: str, kcal: float) -> dict[str, object]:
    """Return it in kcal and, for languages whose food labels have them, in kJ."""
    return {name: _rounded(kcal), f"{name}_kj": _rounded(kj_from_kcal(kcal))}


def _rounded(value: float) -> str:
    """Round to two significant digits, the precision of an amount from photographs."""
    return f"{float(f'{value:.2g}'):.0f}" if value >= 1.0 else f"{value:.1f}"
