"""Described region and circumstances -> ranked foods with probabilities; it learns from confirmed items.

By Bayes' rule: how likely the looks (kernel_classifier, calibrate), how likely the size (sizes),
how likely that somebody eats this now (habits), each for every food that the index knows and for
none of them.
"""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.identification.examples import Examples, NumberedIndex
from app.identification.food_index import FoodIndex
from app.identification.groups import group_probabilities
from app.identification.habits import (
    COMPANY,
    USUAL,
    Eaten,
    log_prior,
    new_food_share,
    time_weights,
)
from app.identification.kernel_classifier import KernelClassifier, posterior
from app.identification.metric import Vectors
from app.identification.sizes import SIZE_TELLS, FoodSize, food_sizes, size_log_likelihoods

MOST_CANDIDATES = 200  # of thousands of foods; nobody reads the others


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What is known of an item beside its looks.

    own: the confirmed items of its eater
    day_minute: local
    beside: foods of the same meal
    looks_alone: nothing of this counts
    """

    volume_ml: float | None = None
    volume_relative_sd: float = 0.0
    day_minute: int | None = None
    own: Sequence[Eaten] = ()
    eater: str | None = None
    beside: frozenset[str] = frozenset()
    looks_alone: bool = False

    @property
    def has_company(self) -> bool:
        """Return whether anything was eaten with a food that lies beside it now."""
        return any(not eaten.beside.isdisjoint(self.beside) for eaten in self.own)


NO_CIRCUMSTANCES = Circumstances()


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that it may be.

    name, label: of the shipped index, None for a food that was learned.
    specimens: pieces or servings that it is known by
    reasons: what speaks for or against it beside its looks: eaten_before, eaten_with, usual_in_study,
        size_fits, size_unusual
    """

    name: str | None
    label: str | None
    food_key: str
    probability: float
    specimens: int
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Identification:
    """What a region may be.

    candidates: the likeliest foods, best first
    groups: of foods, each in place of its members, best first; label and name None
    none_probability: that it is none of all that the index knows
    """

    candidates: tuple[Candidate, ...]
    groups: tuple[Candidate, ...]
    none_probability: float
    index_version: str


class Identifier:
    """An index with learned examples, which must not change while it is in use."""

    def __init__(
        self,
        numbered: NumberedIndex,
        own: Examples | None = None,
        others: Sequence[Examples] = (),
        *,
        groups: Mapping[str, Collection[str]] | None = None,
        none_prior: float | None = None,
    ) -> None:
        """own: of the study itself; others: of studies that share their index.

        groups: key -> its members' food keys
        none_prior: probability of a food unknown to the index; None: from own examples.

        Raises ValueError if none_prior is not between 0 and 1.
        """
        if none_prior is not None and not 0.0 < none_prior < 1.0:
            raise ValueError(
                f"the share of foods that the index does not know is between 0 and 1, not {none_prior}"
            )
        index = numbered.index
        self._numbered, self._names = numbered, list(numbered.foods)
        self._own = own if own is not None else Examples(numbered)
        learned = (self._own, *others)
        self._sources = [each for each in (numbered.examples, *learned) if len(each)]
        tallies = [numbered.tally(), *(each.tally() for each in learned)]
        self._specimens, *pieces = np.sum(tallies, axis=0)
        self._log_means, self._log_sds = food_sizes(*pieces)
        self._known = np.flatnonzero(self._specimens)
        members = {
            key: np.isin(self._known, [numbered.foods.get(food, -1) for food in foods])
            for key, foods in (groups or {}).items()
        }
        self._groups = {key: own for key, own in members.items() if own.sum() > 1}
        confirmed = tallies[1][0]
        if none_prior is None:
            none_prior = new_food_share(confirmed, self._specimens > confirmed)
        self._none_prior = none_prior
        self.version = _version(index, self._own, others)
        self.vcm_version = index.vcm_version

    def size_of(self, food_key: str) -> FoodSize | None:
        """Return the size of a food's next piece; None where no piece of it was measured."""
        number = self._numbered.foods.get(food_key)
        if number is None or not np.isfinite(self._log_means[number]):
            return None
        return FoodSize(float(self._log_means[number]), float(self._log_sds[number]))

    def sizes_by_looks(self, vector: Vectors) -> list[tuple[float, FoodSize]]:
        """Return the probability of each food of known size by looks alone, with its size.

        Raises as identify.
        """
        return [
            (candidate.probability, size)
            for candidate in self.identify(vector).candidates
            if (size := self.size_of(candidate.food_key)) is not None
        ]

    def identify(
        self,
        vector: Vectors,
        circumstances: Circumstances = NO_CIRCUMSTANCES,
    ) -> Identification:
        """The likeliest foods, and how likely a region is of each.

        vector: (d,) of vcm_version, or (n, d) of several views of it

        Raises ValueError if a vector is of another length or not finite.
        """
        index, known = self._numbered.index, self._known
        views = index.metric.embed(np.atleast_2d(np.asarray(vector, np.float64)))
        scores: Vectors = np.mean([self._scores(view) for view in views], axis=0)[known]
        likelihoods, none = index.calibration.log_likelihoods(scores[None])
        log_odds, reasons = self._context(circumstances)
        shares, none_share = posterior(likelihoods, none, log_odds, self._none_prior)
        best = np.argsort(-shares[0], kind="stable")[:MOST_CANDIDATES]
        return Identification(
            tuple(
                self._candidate(
                    int(known[i]),
                    float(shares[0, i]),
                    tuple(name for name, holds in reasons.items() if holds[i]),
                )
                for i in best
            ),
            self._group_candidates(scores, log_odds),
            float(none_share[0]),
            self.version,
        )

    def _group_candidates(self, scores: Vectors, log_odds: Vectors) -> tuple[Candidate, ...]:
        shares = group_probabilities(
            scores, log_odds, self._groups, self._numbered.index.calibration, self._none_prior
        )
        specimens = self._specimens[self._known]
        return tuple(
            Candidate(None, None, key, shares[key], int(specimens[self._groups[key]].sum()))
            for key in sorted(shares, key=lambda key: -shares[key])
        )

    def _scores(self, view: Vectors) -> Vectors:
        """(foods,) of a region, (k,), from the examples that may be nearest to it."""
        near = [each.near(view) for each in self._sources]
        examples, foods = (np.concatenate(parts) for parts in zip(*near, strict=True))
        classifier = KernelClassifier(examples.astype(np.float64), foods, len(self._names))
        return classifier.scores(view[None]).ravel()

    def _context(
        self, circumstances: Circumstances
    ) -> tuple[Vectors, dict[str, NDArray[np.bool_]]]:
        """(known,) log odds of each food by size and habit; reason -> (known,) for which it holds."""
        known, nothing = self._known, np.zeros(len(self._known))
        if circumstances.looks_alone:
            return log_prior(nothing, nothing), {}
        sizes = size_log_likelihoods(
            self._log_means[known],
            self._log_sds[known],
            circumstances.volume_ml,
            circumstances.volume_relative_sd,
        )
        count, weights = len(self._names), time_weights(circumstances.day_minute)
        facts, eater = self._own.facts, circumstances.eater
        counts = weights[facts["minute"]]
        if eater is not None:
            counts[facts["eater"] == hash(eater)] = 0.0
        of_study = np.bincount(facts["food"], counts, count).astype(np.float64)[known]
        of_own, of_company = np.zeros(count), np.zeros(count)
        for eaten in circumstances.own:
            if eaten.food_key in self._numbered.foods:
                number, weight = self._numbered.foods[eaten.food_key], weights[eaten.day_minute]
                of_own[number] += weight
                of_company[number] += weight * (not eaten.beside.isdisjoint(circumstances.beside))
        own, company = of_own[known], of_company[known]
        study_share = log_prior(nothing, of_study)
        reasons = {
            "eaten_before": own > 0.0,
            "eaten_with": company > 0.0,
            "usual_in_study": (of_study > 0.0) & (study_share > np.log(USUAL / len(known))),
            "size_fits": sizes > SIZE_TELLS,
            "size_unusual": sizes < -SIZE_TELLS,
        }
        return sizes + log_prior(own + (COMPANY - 1.0) * company, of_study), reasons

    def _candidate(self, number: int, probability: float, reasons: tuple[str, ...]) -> Candidate:
        shipped = self._numbered.index.foods[number : number + 1]
        name, label = (shipped[0].name, shipped[0].label) if shipped else (None, None)
        return Candidate(
            name, label, self._names[number], probability, int(self._specimens[number]), reasons
        )


def _version(index: FoodIndex, own: Examples, others: Sequence[Examples]) -> str:
    """Return the index's version, with the number and a digest of what is learned, own examples told from others."""
    learned = (own, *others)
    count = sum(map(len, learned))
    if count == 0:
        return index.version
    of_own, *of_others = (int(each.facts["digest"].sum()) for each in learned)
    digest = hashlib.sha256(f"{of_own} {sum(of_others)}".encode())
    return f"{index.version} + {count} confirmed {digest.hexdigest()[:12]}"
