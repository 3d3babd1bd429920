"""The share of a study's participants whose intake is inadequate: the EAR cut-point, by life stage, on closed days.

A few days of one person say little about their usual intake; those of a group do, once day-to-day
variation is removed (usual_intake.py). Where the method is not valid, the result gives the reason
instead of a share. Results are reproducible: the same data give the same result.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from functools import cache

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.db.session import Database
from app.db.statements import AnyColumn
from app.diary.day_definition import (
    Amount,
    DayKey,
    DaysOf,
    count_days,
    days_of_study,
    group_by_day,
    sum_and_coverage,
    whole_amount,
)
from app.diary.schemas import AdequacyOut, Reason, StageAdequacyOut, VariancesOut
from app.diary.study_days import person_on, stage_of
from app.foods.models import Component as FoodComponent
from app.foods.models import FoodNutrient
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    ENERGY_NUMBERS,
    HEADLINE_BY_COLUMN,
    HEADLINES,
    NUMBER_BY_TAGNAME,
    Component,
)
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import ReferenceIntake, reference_intakes
from app.people.access.caller import Caller
from app.people.models import Participant
from app.people.profiles import Profile
from app.people.studies import enter_study

NOT_EATEN = Amount(None, None)


@dataclass(slots=True)
class ClosedAmounts:
    """A participant's closed days, at least one.

    amounts: of the days on which it is known, in order.
    """

    profile: Profile | None
    last_day: date = date.min
    days: int = 0
    amounts: list[float] = field(default_factory=list)


def closed_amounts(
    session: Session,
    chosen: DaysOf,
    *,
    least_coverage: float,
    column: str | None = None,
    contents: Mapping[DayKey, Amount] | None = None,
) -> list[ClosedAmounts]:
    """Return the amounts of all participants with a closed day, by participant id.

    column: one of HEADLINE_COLUMNS; or contents: the amounts of any component by day
    """
    query = sa.select(Participant.id, Participant.profile).where(
        Participant.id.in_(chosen.participants)
    )
    people = {
        row[0]: ClosedAmounts(row[1]) for row in session.execute(query.order_by(Participant.id))
    }
    for day in count_days(session, chosen):
        if not day.is_closed:
            continue
        if contents is None:
            amount = day.whole_amount(str(column), least_coverage)
        else:
            content = contents.get((day.local_date, day.participant_id), NOT_EATEN)
            amount = whole_amount(day, content, least_coverage)
        person = people[day.participant_id]
        person.days += 1
        person.last_day = day.local_date
        if amount is not None:
            person.amounts.append(amount)
    return [person for person in people.values() if person.days]


def contents_of_days(
    session: Session, chosen: DaysOf, number: str, subtracted: str | None
) -> dict[DayKey, Amount]:
    """Sum a component of the food table over each day's records.

    subtracted: number of a component to subtract (fibre from carbohydrate); the difference is
    unknown where it is.
    """
    record, content = EffectiveRecord, _contents(number)
    per_100_g: AnyColumn = content.c.per_100_g
    source = sa.outerjoin(record, content, content.c.food_id == record.food_id)
    if subtracted is not None:
        other = _contents(subtracted)
        per_100_g = per_100_g - other.c.per_100_g
        source = source.outerjoin(other, other.c.food_id == record.food_id)
    amount = record.consumed_g * per_100_g / 100.0
    query = sa.select(
        record.local_date, record.participant_id, *sum_and_coverage(amount)
    ).select_from(source)
    rows = session.execute(group_by_day(query, chosen, record).where(record.status != "rejected"))
    return {(row[0], row[1]): Amount(row[2], row[3]) for row in rows}


def _contents(number: str) -> sa.Subquery:
    return (
        sa.select(FoodNutrient.food_id, FoodNutrient.per_100_g)
        .join(FoodComponent, FoodComponent.id == FoodNutrient.component_id)
        .where(FoodComponent.number == number)
        .subquery()
    )


# of a day's grams; days with less are left out, since they would count as a low intake
MIN_COVERAGE = 0.9
COLUMNS: Mapping[str, str] = {headline.numbers[0]: headline.column for headline in HEADLINES}
SUBTRACTED: Mapping[str, str] = {
    "205": "291"
}  # the requirement is of available carbohydrate: subtract fibre
IRON = "303"
NIACIN = "406"  # preformed; the need is of equivalents, to which tryptophan adds much (IOM 1998, chapter 6)
MENSTRUATING = frozenset(  # their requirement of iron is skewed, so the cut-point is not valid (IOM 2001, chapter 9)
    {
        LifeStage.FEMALE_14_18,
        LifeStage.FEMALE_19_30,
        LifeStage.FEMALE_31_50,
    }
)
METHOD = (
    "EAR cut-point (Beaton 1994) on usual intakes from closed days, adjusted for day-to-day variation "
    "(NRC 1986, IOM 2000)."
)
SEED = 1986  # arbitrary; makes the interval reproducible


@dataclass(slots=True)
class _Group:
    reference: ReferenceIntake | None
    days: list[list[float]] = field(default_factory=list)
    days_left_out: int = 0


def find_component(name: str) -> Component:
    """Find a component by number, tagname or record column.

    Raises InvalidInputError (`component_unknown`).
    """
    number = (
        HEADLINE_BY_COLUMN[name].numbers[0]
        if name in HEADLINE_BY_COLUMN
        else NUMBER_BY_TAGNAME.get(name, name)
    )
    if number not in COMPONENT_BY_NUMBER:
        raise InvalidInputError(f"No component {name!r}.", code="component_unknown", component=name)
    return COMPONENT_BY_NUMBER[number]


def judge_study(
    database: Database,
    caller: Caller,
    study_code: str,
    component_name: str,
    *,
    first_day: date | None,
    last_day: date | None,
) -> AdequacyOut:
    """Judge the intake of a component by number, tagname or record column.

    Raises NotFoundError, InvalidInputError.
    """
    component = find_component(component_name)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        participants = _read_amounts(
            session, days_of_study(study.id, first_day, last_day), component.number
        )
    groups: dict[LifeStage, _Group] = {}
    persons_without_stage = 0
    for participant in participants:
        assignment = _assign_stage(participant.profile, participant.last_day, component.number)
        if assignment is None:
            persons_without_stage += 1
            continue
        stage, reference, divisor = assignment
        group = groups.setdefault(stage, _Group(reference))
        group.days_left_out += participant.days - len(participant.amounts)
        if participant.amounts:
            group.days.append([amount / divisor for amount in participant.amounts])
    return AdequacyOut(
        number=component.number,
        tagname=component.tagname,
        name=component.name,
        unit=component.unit,
        groups=[
            _judge(stage, groups[stage], component.number) for stage in LifeStage if stage in groups
        ],
        persons_without_stage=persons_without_stage,
        method=METHOD,
    )


def _read_amounts(session: Session, chosen: DaysOf, number: str) -> list[ClosedAmounts]:
    subtracted = SUBTRACTED.get(number)
    if subtracted is None and number in COLUMNS:
        return closed_amounts(session, chosen, column=COLUMNS[number], least_coverage=MIN_COVERAGE)
    contents = contents_of_days(session, chosen, number, subtracted)
    return closed_amounts(session, chosen, contents=contents, least_coverage=MIN_COVERAGE)


def _assign_stage(
    profile: Profile | None, day: date, number: str
) -> tuple[LifeStage, ReferenceIntake | None, float] | None:
    """Return (stage, its reference, divisor of daily amounts); None if the stage, or a weight it needs, is unknown."""
    person = person_on(profile, day)
    stage = stage_of(person) if person is not None else None
    if person is None or stage is None:
        return None
    reference = _reference(stage, number)
    if reference is None or reference.per == "day":
        return stage, reference, 1.0
    return None if person.weight_kg is None else (stage, reference, person.weight_kg)


@cache
def _reference(stage: LifeStage, number: str) -> ReferenceIntake | None:
    """Return the reference that a group of this stage is compared with; None if there is no EAR."""
    with_ear = [
        intake
        for intake in reference_intakes(stage)
        if intake.number == number and intake.ear is not None
    ]
    # prefer per day to per kilogram
    return min(with_ear, key=lambda intake: intake.per != "day", default=None)


def _judge(stage: LifeStage, group: _Group, number: str) -> StageAdequacyOut:
    reference = group.reference
    adequacy = StageAdequacyOut(
        life_stage=stage,
        persons=len(group.days),
        days=sum(map(len, group.days)),
        days_left_out=group.days_left_out,
        ear=reference.ear if reference is not None else None,
        per=reference.per if reference is not None else None,
        compared_with=reference.compared_with if reference is not None else None,
        mean_usual_intake=None,
        share_below_ear=None,
        share_interval=None,
        unadjusted_share=None,
        variances=None,
        reason=_reason_against(stage, reference, number),
    )
    if adequacy.reason is not None or adequacy.ear is None:
        return adequacy
    import numpy as np  # noqa: PLC0415  # 13 MB that the process does not need otherwise

    from app.nutrition.intakes.usual_intake import NotJudged, judge_group  # noqa: PLC0415  # imports numpy

    judged = judge_group(group.days, adequacy.ear, np.random.default_rng(SEED))
    if isinstance(judged, NotJudged):
        adequacy.reason = judged.reason
        return adequacy
    adequacy.mean_usual_intake = judged.mean
    adequacy.share_below_ear = judged.share_below
    adequacy.share_interval = (judged.share_low, judged.share_high)
    adequacy.unadjusted_share = judged.unadjusted_share
    adequacy.variances = VariancesOut(
        scale=judged.scale, within=judged.variances.within, between=judged.variances.between
    )
    return adequacy


def _reason_against(
    stage: LifeStage, reference: ReferenceIntake | None, number: str
) -> Reason | None:
    """Return why the cut-point method is not valid; None if it is."""
    if number in ENERGY_NUMBERS:
        return "energy_follows_need"  # intake and requirement of energy are correlated (IOM 2000)
    if reference is None:
        return "no_ear"
    if number == IRON and stage in MENSTRUATING:
        return "need_is_skewed"
    return "intake_is_lower_bound" if number == NIACIN else None
