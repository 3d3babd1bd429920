"""How much of a study's group eats less than it needs: the EAR cut-point, by life stage, on closed days.

A person's few days say little about their need; a group's do, once the days' own scatter is taken out
(usual_intake.py). Where the method does not hold, no share is told but why. The answer to the same data is
the same each time.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cache
from typing import TYPE_CHECKING, Literal

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.db.session import Database
from app.diary.closed_amounts import ClosedAmounts, amounts_by_column, amounts_by_record
from app.diary.study_days import person_on, stage_of
from app.foods.food_amounts import RECORD_COLUMNS
from app.nutrition.components import COMPONENT_BY_NUMBER, ENERGY_NUMBERS, NUMBER_BY_TAGNAME, Component
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import Per, ReferenceIntake, reference_intakes
from app.people.access.caller import Caller
from app.people.studies import enter_study

if TYPE_CHECKING:
    from app.nutrition.intakes.usual_intake import Scale

MIN_COVERAGE = 0.9  # of a day's grams; a day of which less is known is left out, since it would count as little eaten
COLUMNS: Mapping[str, str] = {numbers[0]: column for column, numbers in RECORD_COLUMNS.items()}
LESS: Mapping[str, str] = {"205": "291"}  # the requirement is of available carbohydrate: fibre is taken off
IRON = "303"
NIACIN = "406"  # preformed; the need is of equivalents, to which tryptophan adds much (IOM 1998, chapter 6)
MENSTRUATING = frozenset(  # their need of iron is skewed: half the group is not below the EAR (IOM 2001, chapter 9)
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
SEED = 1986  # any number: the interval's draws are the same each time

Reason = Literal[
    "energy_follows_need",
    "no_ear",
    "need_is_skewed",
    "intake_is_lower_bound",
    "too_few_persons",
    "no_repeated_days",
    "no_difference_between_persons",
]


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components on the scale of analysis, within a person's days and between persons."""

    scale: "Scale"
    within: float
    between: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StageAdequacy:
    """A life stage's group. ear: a day, or a day and kilogram of body weight. Without a share `reason` says why.

    days: that were used; days_left_out: closed days that were not, since too little is known of them.
    """

    life_stage: LifeStage
    persons: int
    days: int
    days_left_out: int
    ear: float | None
    per: Per | None
    compared_with: str | None
    mean_usual_intake: float | None = None
    share_below_ear: float | None = None
    share_interval: tuple[float, float] | None = None
    unadjusted_share: float | None = None
    variances: Variances | None = None
    reason: Reason | None


@dataclass(frozen=True, slots=True)
class Adequacy:
    """A study's groups. persons_without_stage: with closed days, whose life stage (or weight) is not known."""

    number: str
    tagname: str | None
    name: str
    unit: str
    groups: tuple[StageAdequacy, ...]
    persons_without_stage: int
    method: str = METHOD


@dataclass(slots=True)
class _Group:
    reference: ReferenceIntake | None
    days: list[list[float]] = field(default_factory=list)
    left_out: int = 0


def find_component(name: str) -> Component:
    """By number, tagname or record's column. Raises InvalidInputError (`component_unknown`)."""
    number = RECORD_COLUMNS[name][0] if name in RECORD_COLUMNS else NUMBER_BY_TAGNAME.get(name, name)
    if number not in COMPONENT_BY_NUMBER:
        raise InvalidInputError(f"No component {name!r}.", code="component_unknown", component=name)
    return COMPONENT_BY_NUMBER[number]


def judge_study(
    database: Database,
    caller: Caller,
    study_code: str,
    component: str,
    *,
    first_day: date | None,
    last_day: date | None,
) -> Adequacy:
    """Judge a component by number, tagname or record's column. Raises NotFoundError, InvalidInputError."""
    asked = find_component(component)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        people = _people(session, study.id, asked.number, first_day, last_day)
    groups: dict[LifeStage, _Group] = {}
    without = 0
    for person in people:
        placed = _placed(person.profile, person.last_day, asked.number)
        if placed is None:
            without += 1
            continue
        stage, reference, divisor = placed
        group = groups.setdefault(stage, _Group(reference))
        group.left_out += person.days - len(person.amounts)
        if person.amounts:
            group.days.append([amount / divisor for amount in person.amounts])
    judged = tuple(_judge(stage, groups[stage], asked.number) for stage in LifeStage if stage in groups)
    return Adequacy(asked.number, asked.tagname, asked.name, asked.unit, judged, without)


def _people(
    session: Session, study_id: uuid.UUID, number: str, first_day: date | None, last_day: date | None
) -> list[ClosedAmounts]:
    less = LESS.get(number)
    if less is None and number in COLUMNS:
        return amounts_by_column(
            session,
            study_id,
            COLUMNS[number],
            least_coverage=MIN_COVERAGE,
            first_day=first_day,
            last_day=last_day,
        )
    return amounts_by_record(
        session,
        study_id,
        number,
        less,
        least_coverage=MIN_COVERAGE,
        first_day=first_day,
        last_day=last_day,
    )


def _placed(
    profile: Mapping[str, object] | None, day: date, number: str
) -> tuple[LifeStage, ReferenceIntake | None, float] | None:
    """(stage, its reference, what daily amounts are divided by); None without a stage, or a weight that is needed."""
    person = person_on(profile, day)
    if person is None:
        return None
    stage = stage_of(person.age_years, person.known_sex, person.is_pregnant, person.is_lactating)
    if stage is None:
        return None
    reference = _reference(stage, number)
    if reference is None or reference.per == "day":
        return stage, reference, 1.0
    return None if person.weight_kg is None else (stage, reference, person.weight_kg)


@cache
def _reference(stage: LifeStage, number: str) -> ReferenceIntake | None:
    """What a group of this stage is compared with; None where there is no EAR."""
    with_ear = [each for each in reference_intakes(stage) if each.number == number and each.ear is not None]
    return min(with_ear, key=lambda each: each.per != "day", default=None)  # a day's figure before one a kilogram


def _judge(stage: LifeStage, group: _Group, number: str) -> StageAdequacy:
    reference = group.reference
    adequacy = StageAdequacy(
        life_stage=stage,
        persons=len(group.days),
        days=sum(map(len, group.days)),
        days_left_out=group.left_out,
        ear=reference.ear if reference is not None else None,
        per=reference.per if reference is not None else None,
        compared_with=reference.compared_with if reference is not None else None,
        reason=_why_not(stage, reference, number),
    )
    if adequacy.reason is not None or adequacy.ear is None:
        return adequacy
    import numpy as np  # noqa: PLC0415  # 13 MB of a process that has no other use for it

    from app.nutrition.intakes.usual_intake import NotJudged, judge_group  # noqa: PLC0415  # with it

    judged = judge_group(group.days, adequacy.ear, np.random.default_rng(SEED))
    if isinstance(judged, NotJudged):
        return replace(adequacy, reason=judged.reason)
    return replace(
        adequacy,
        mean_usual_intake=judged.mean,
        share_below_ear=judged.share_below,
        share_interval=(judged.share_low, judged.share_high),
        unadjusted_share=judged.unadjusted_share,
        variances=Variances(judged.scale, judged.variances.within, judged.variances.between),
    )


def _why_not(stage: LifeStage, reference: ReferenceIntake | None, number: str) -> Reason | None:
    if number in ENERGY_NUMBERS:
        return "energy_follows_need"  # people eat as much energy as they need: the two go together (IOM 2000)
    if reference is None:
        return "no_ear"
    if number == IRON and stage in MENSTRUATING:
        return "need_is_skewed"
    return "intake_is_lower_bound" if number == NIACIN else None
