"""How far the reviewers of a study agree with each other, and with the items with a known answer."""

import uuid
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.records.double_review import queries as double
from app.records.double_review.agreement import Amounts, Figure, agreement_of, cohens_kappa
from app.records.double_review.schemas import DecisionOut

Stated = DecisionOut | ReviewDecision | KnownItem


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a reviewer agrees with another; other "": with all others, or with what is known.

    items: that both have decided; same: those with the same food
    """

    reviewer: str
    other: str
    items: int
    same: int
    kappa: Figure | None
    grams: Amounts
    energy: Amounts


def study_agreement(session: Session, study_id: uuid.UUID) -> list[Agreement]:
    """Return the agreement of each reviewer with all others, then of each pair, by name."""
    pairs = []
    for first, second, *_ in double.decided_by_two(session, study_id):
        pairs.append(("", first.reviewer, first, second))
        pairs.append(("", second.reviewer, second, first))
        pairs.append((second.reviewer, first.reviewer, first, second))
    return _by_names(pairs)


def known_agreement(session: Session, study_id: uuid.UUID) -> list[Agreement]:
    """Return the agreement of each reviewer with the known answers, by name."""
    return _by_names(("", *row) for row in double.known_decisions(session, study_id))


def _by_names(stated: Iterable[tuple[str, str, Stated, Stated]]) -> list[Agreement]:
    """stated: (other, reviewer, what the reviewer stated, what the other did)."""
    by_names = defaultdict(list)
    for other, reviewer, *pair in stated:
        by_names[other, reviewer].append(pair)
    rows = []
    for (other, reviewer), pairs in sorted(by_names.items(), key=lambda item: item[0]):
        foods = [(str(a.food_key), str(b.food_key)) for a, b in pairs]
        grams = _amounts([(a.mass_g, b.mass_g) for a, b in pairs])
        energy = _amounts([(a.energy_kcal, b.energy_kcal) for a, b in pairs])
        same, kappa = sum(a == b for a, b in foods), cohens_kappa(foods)
        rows.append(Agreement(reviewer, other, len(pairs), same, kappa, grams, energy))
    return rows


def _amounts(stated: Sequence[tuple[float | None, float | None]]) -> Amounts:
    return agreement_of([(a, b) for a, b in stated if a is not None and b is not None])
