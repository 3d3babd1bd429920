"""How far the reviewers of a study agree with each other, and with the items with a known answer."""

import uuid
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy.orm import Session

from app.records.double_review import queries as double
from app.records.double_review.agreement import Amounts, Figure, agreement_of, cohens_kappa


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a reviewer agrees with another; other "": with all others.

    items: that both have decided
    """

    reviewer: str
    other: str
    items: int
    kappa: Figure | None
    grams: Amounts
    energy: Amounts


@dataclass(frozen=True, slots=True)
class KnownResult:
    """What a reviewer made of known items. right: foods; grams: with the true ones as the other's."""

    reviewer: str
    items: int
    right: int
    grams: Amounts


def study_agreement(session: Session, study_id: uuid.UUID) -> list[Agreement]:
    """Return the agreement of each reviewer with all others, then of each pair, by name."""
    by_names = defaultdict(list)
    for first, second, *_ in double.decided_by_two(session, study_id):
        by_names["", first.reviewer].append((first, second))
        by_names["", second.reviewer].append((second, first))
        by_names[second.reviewer, first.reviewer].append((first, second))
    return [
        Agreement(
            reviewer=name,
            other=other,
            items=len(pairs),
            kappa=cohens_kappa([(str(a.food), str(b.food)) for a, b in pairs]),
            grams=_amounts([(a.mass_g, b.mass_g) for a, b in pairs]),
            energy=_amounts([(a.energy_kcal, b.energy_kcal) for a, b in pairs]),
        )
        for (other, name), pairs in sorted(by_names.items(), key=lambda item: item[0])
    ]


def known_results(session: Session, study_id: uuid.UUID) -> list[KnownResult]:
    """Return each reviewer's result by the items with a known answer, by name."""
    results = []
    rows = double.known_decisions(session, study_id)
    for name, group in groupby(rows, key=lambda row: row[0]):
        pairs = [(decision, known) for _, decision, known in group]
        right = sum(decision.food_key == known.food_key for decision, known in pairs)
        grams = _amounts([(decision.mass_g, known.mass_g) for decision, known in pairs])
        results.append(KnownResult(name, len(pairs), right, grams))
    return results


def _amounts(stated: Sequence[tuple[float | None, float | None]]) -> Amounts:
    return agreement_of([(a, b) for a, b in stated if a is not None and b is not None])
