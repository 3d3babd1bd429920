"""How far a study's days agree with the reference: by nutrient, of participants' means over the same days.

Days of one participant are no independent pairs, so a participant counts once
(docs/decisions/0073-participants-are-compared.md).
"""

import statistics
import uuid
from collections import defaultdict
from collections.abc import Mapping

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.day_definition import CountedDay, DayKey, DaysOf, count_days
from app.diary.references.models import ReferenceDay
from app.diary.references.schemas import NutrientAgreementOut
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Participant
from app.records.double_review.agreement import Amounts, Pair, agreement_of, correlation_of

ReferenceAmounts = Mapping[DayKey, Mapping[str, float]]
OwnDays = Mapping[DayKey, CountedDay]


def compare_with_reference(
    session: Session, study_id: uuid.UUID
) -> list[tuple[NutrientAgreementOut, Amounts]]:
    """Return the figures of each nutrient that the reference has, and participants' means.

    Of the means, the study's comes first, then the reference's.
    """
    query = sa.select(ReferenceDay).join(Participant).where(Participant.study_id == study_id)
    days = session.scalars(query.order_by(ReferenceDay.local_date, ReferenceDay.participant_id))
    reference = {(day.local_date, day.participant_id): day.amounts for day in days}
    if not reference:
        return []
    participants = {participant_id for _, participant_id in reference}
    counted = count_days(session, DaysOf(participants, min(reference)[0], max(reference)[0]))
    own_days = {(day.local_date, day.participant_id): day for day in counted}
    return [
        _compare(column, reference, own_days)
        for column in HEADLINE_COLUMNS
        if any(column in amounts for amounts in reference.values())
    ]


def _compare(
    column: str, reference: ReferenceAmounts, own_days: OwnDays
) -> tuple[NutrientAgreementOut, Amounts]:
    pairs_of = defaultdict[uuid.UUID, list[Pair]](list)
    left_out = 0
    for key, amounts in reference.items():
        if column not in amounts:
            continue
        day = own_days.get(key)
        own = day.whole_amount(column) if day is not None else None
        if own is None:
            left_out += 1
        else:
            pairs_of[key[1]].append((own, amounts[column]))
    means = [_means(pairs) for pairs in pairs_of.values()]
    limits = agreement_of(means)
    mean, reference_mean = _means(means) if means else (None, None)
    figures = {
        "nutrient": column,
        "participants": len(means),
        "days": sum(map(len, pairs_of.values())),
        "days_left_out": left_out,
        "mean": mean,
        "reference_mean": reference_mean,
        "bias": limits.bias,
        "lower": limits.lower,
        "upper": limits.upper,
        "correlation": correlation_of(means),
    }
    return NutrientAgreementOut.model_validate(figures), limits


def _means(pairs: list[Pair]) -> Pair:
    first, second = zip(*pairs, strict=True)
    return statistics.fmean(first), statistics.fmean(second)
