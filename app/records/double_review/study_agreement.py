"""How far the reviewers of a study agree with each other, and with the items with a known answer."""

import uuid
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.records.double_review.agreement import (
    Figure,
    Limits,
    Pair,
    cohens_kappa,
    icc_2_1,
    limits_of_agreement,
    share_right,
)
from app.records.double_review.queries import MadeDecision, made_decisions


@dataclass(frozen=True, slots=True)
class Amounts:
    """Amounts that two stated of the same items: the reviewer's, the other's."""

    pairs: Sequence[Pair]
    icc: Figure | None
    limits: Limits | None


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a reviewer agrees with another; other None: with all others. items: that both decided."""

    reviewer: str
    other: str | None
    items: int
    kappa: Figure | None
    grams: Amounts
    energy: Amounts


@dataclass(frozen=True, slots=True)
class KnownResult:
    """What a reviewer made of known items. grams: the stated less the true ones."""

    reviewer: str
    items: int
    right: Figure
    grams: Limits | None


def decided_by_two(session: Session, study_id: uuid.UUID) -> list[list[MadeDecision]]:
    """Return the decisions about each item that two have decided, a third's last."""
    condition = ReviewDecision.study_id == study_id, ReviewDecision.meal_id.is_not(None)
    rows = made_decisions(session, sa.and_(*condition))
    groups = [list(group) for _, group in groupby(rows, key=lambda row: row.decision.item_id)]
    return [group for group in groups if len(group) > 1]


def study_agreement(session: Session, study_id: uuid.UUID) -> list[Agreement]:
    """Return the agreement of each reviewer with all others, then of each pair, by name."""
    by_names = defaultdict(list)
    for first, second, *_ in decided_by_two(session, study_id):
        a, b = first.reviewer, second.reviewer
        by_names["", a, ""].append((first.decision, second.decision))
        by_names["", b, ""].append((second.decision, first.decision))
        by_names["pair", a, b].append((first.decision, second.decision))
    return [
        Agreement(
            reviewer=reviewer,
            other=other or None,
            items=len(pairs),
            kappa=cohens_kappa([(str(a.food_key), str(b.food_key)) for a, b in pairs]),
            grams=_amounts([(a.mass_g, b.mass_g) for a, b in pairs]),
            energy=_amounts([(a.energy_kcal, b.energy_kcal) for a, b in pairs]),
        )
        for (_, reviewer, other), pairs in sorted(by_names.items(), key=itemgetter(0))
    ]


def known_results(session: Session, study_id: uuid.UUID) -> list[KnownResult]:
    """Return each reviewer's result by the items with a known answer, by name."""
    by_name = defaultdict(list)
    for row in made_decisions(session, KnownItem.study_id == study_id):
        if row.known is not None:
            by_name[row.reviewer].append((row.decision, row.known))
    return [
        KnownResult(
            reviewer=name,
            items=len(pairs),
            right=share_right([decision.food_key == known.food_key for decision, known in pairs]),
            grams=_amounts([(decision.mass_g, known.mass_g) for decision, known in pairs]).limits,
        )
        for name, pairs in sorted(by_name.items())
    ]


def _amounts(stated: Sequence[tuple[float | None, float | None]]) -> Amounts:
    pairs = [(a, b) for a, b in stated if a is not None and b is not None]
    return Amounts(pairs, icc_2_1(pairs), limits_of_agreement(pairs))
