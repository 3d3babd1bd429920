"""Described region and circumstances -> ranked foods with probabilities; it learns by what was confirmed.

By Bayes' rule: how likely the looks (kernel_classifier, calibrate), how likely the size (sizes), how likely that
somebody eats this now (habits), each for every food that the index knows and for none of them.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.identification.calibrate import posterior
from app.identification.food_index import FoodIndex
from app.identification.habits import Eaten, log_prior, new_food_share
from app.identification.kernel_classifier import fit_classifier
from app.identification.metric import Vectors
from app.identification.sizes import FoodSize, food_size, size_log_likelihood

MOST_EXAMPLES = 1400  # learned, beside those that ship: what one linear system solves in less than a second
LEAST_A_FOOD = 5


@dataclass(frozen=True, slots=True)
class Example:
    """A confirmed item: vector (d,) by the index's VCM version; the rest as far as it is known.

    name: unique, for the index's version. is_own: of the study itself, not of one that shares its index.
    """

    name: str
    food_key: str
    vector: Vectors
    volume_ml: float | None = None
    day_minute: int = 720
    is_own: bool = True


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What is known of an item beside its looks. own: the participant's confirmed items. day_minute: local."""

    volume_ml: float | None = None
    volume_relative_sd: float = 0.0
    day_minute: int | None = None
    own: Sequence[Eaten] = ()


NOTHING_KNOWN = Circumstances()


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that it may be. name, label: of the shipped index, None for a food that was learned."""

    name: str | None
    label: str | None
    food_key: str
    probability: float


@dataclass(frozen=True, slots=True)
class Identification:
    """candidates: best first; none_probability: that it is none of all that the index knows."""

    candidates: tuple[Candidate, ...]
    none_probability: float
    index_version: str


@dataclass(frozen=True, slots=True)
class _Known:
    """A class: a label of the shipped index, a learned food, or both."""

    food_key: str
    name: str | None
    label: str | None
    size: FoodSize | None

    def candidate(self, probability: float) -> Candidate:
        return Candidate(self.name, self.label, self.food_key, probability)


class Identifier:
    """An index with what was learned; immutable: what is confirmed later makes another."""

    def __init__(self, index: FoodIndex, learned: Sequence[Example] = (), *, none_prior: float | None = None) -> None:
        """none_prior: of a food that the index does not know; None: as the study's own examples show (habits)."""
        kept = newest_of_each(learned)
        self._known = _classes(index, kept)
        place = {known.food_key: number for number, known in enumerate(self._known)}
        own_labels = np.array([place[food.food_key] for food in index.foods], np.intp)
        labels = np.concatenate([own_labels[index.labels], np.array([place[one.food_key] for one in kept], np.intp)])
        vectors = np.concatenate([index.vectors, *(one.vector.reshape(1, -1) for one in kept)])
        self._metric, self._calibration = index.metric, index.calibration
        self._classifier = fit_classifier(index.metric.embed(vectors), labels, len(self._known))
        own = [one for one in kept if one.is_own]
        self._eaten = [Eaten(one.food_key, one.day_minute) for one in own]
        shipped = frozenset(food.food_key for food in index.foods)
        shown = new_food_share(shipped, [one.food_key for one in own])
        self._none_prior = none_prior if none_prior is not None else shown
        self.version = _version(index, kept)
        self.vcm_version = index.vcm_version

    def identify(self, vector: Vectors, circumstances: Circumstances = NOTHING_KNOWN, most: int = 10) -> Identification:
        """The likeliest foods of a region. vector: (d,) of vcm_version."""
        scores = self._classifier.scores(self._metric.embed(np.asarray(vector, np.float64).reshape(1, -1)))
        likelihoods, none = self._calibration.log_likelihoods(scores)
        at = circumstances
        sizes = [size_log_likelihood(each.size, at.volume_ml, at.volume_relative_sd) for each in self._known]
        habits = log_prior([each.food_key for each in self._known], at.day_minute, at.own, self._eaten)
        shares, none_share = posterior(likelihoods + np.array(sizes), none, np.array(habits), self._none_prior)
        best = np.argsort(-shares[0], kind="stable")[:most]
        return Identification(
            tuple(self._known[i].candidate(float(shares[0, i])) for i in best),
            float(none_share[0]),
            self.version,
        )


def newest_of_each(learned: Sequence[Example], most: int = MOST_EXAMPLES) -> list[Example]:
    """At most so many examples, the last of each food, the same number a food and LEAST_A_FOOD at least.

    learned: the newest last. Own examples go before those of others.
    """
    by_food: dict[str, list[Example]] = {}
    for one in sorted(learned, key=lambda each: each.is_own):  # stable: own ones last, each part in its order
        by_food.setdefault(one.food_key, []).append(one)
    if len(learned) <= most:
        return list(learned)
    allowed = max(LEAST_A_FOOD, most // len(by_food))
    return [one for of_food in by_food.values() for one in of_food[-allowed:]]


def _classes(index: FoodIndex, learned: Sequence[Example]) -> list[_Known]:
    volumes: dict[str, list[float]] = {}
    for one in learned:
        if one.volume_ml is not None:
            volumes.setdefault(one.food_key, []).append(one.volume_ml)
    known = []
    for food in index.foods:
        pieces = [*index.volumes_ml.get(food.label, ()), *volumes.get(food.food_key, ())]
        known.append(_Known(food.food_key, food.name, food.label, food_size(pieces)))
    shipped = {each.food_key for each in known}
    new = dict.fromkeys(one.food_key for one in learned if one.food_key not in shipped)
    return known + [_Known(key, None, None, food_size(volumes.get(key, ()))) for key in sorted(new)]


def _version(index: FoodIndex, learned: Sequence[Example]) -> str:
    if not learned:
        return index.version
    names = hashlib.sha256("\n".join(f"{one.name} {one.food_key}" for one in learned).encode()).hexdigest()[:12]
    return f"{index.version} + {len(learned)} confirmed {names}"
