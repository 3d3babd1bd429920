"""The amounts of a component that participants ate on their closed days, for usual intakes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.diary.day_definition import (
    Amount,
    DayKey,
    DaysOf,
    count_days,
    group_by_day,
    sum_and_coverage,
    whole_amount,
)
from app.foods.models import Component, FoodNutrient
from app.meals.stored.record_models import EffectiveRecord
from app.people.models import Participant
from app.people.profiles import Profile

NOT_EATEN = Amount(None, None)


@dataclass(slots=True)
class ClosedAmounts:
    """A participant's closed days, at least one. amounts: of the days on which it is known, in order."""

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

    subtracted: number of a component to subtract (fibre from carbohydrate); the difference is unknown where it is.
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
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(Component.number == number)
        .subquery()
    )
