"""Described region and circumstances -> ranked foods with probabilities; it learns by what was confirmed.

By Bayes' rule: how likely the looks (kernel_classifier, calibrate), how likely the size (sizes), how likely that
somebody eats this now (habits), each for every food that the index knows and for none of them.
"""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.identification.calibrate import posterior
from app.identification.food_index import FoodIndex
from app.identification.habits import Eaten, log_prior, new_food_share
from app.identification.kernel_classifier import fit_classifier
from app.identification.metric import Vectors
from app.identification.sizes import FoodSize, food_size, size_log_likelihood

MOST_EATEN = 1400  # of the study's items that show what is eaten at a time of day: each answer looks at all of them
MOST_EXAMPLES = 1400  # learned, beside those that ship: what one linear system solves in less than a second


@dataclass(frozen=True, slots=True)
class Example:
    """A confirmed item: vector (d,) by the index's VCM version; the rest as far as it is known.

    name: unique, for the index's version. is_own: of the study itself, not of one that shares its index. day_minute:
    after local midnight. eater: whose, by any name of theirs.
    """

    name: str
    food_key: str
    vector: Vectors
    volume_ml: float | None = None
    day_minute: int = 720
    is_own: bool = True
    eater: str | None = None


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What is known of an item beside its looks. own: the confirmed items of its eater. day_minute: local."""

    volume_ml: float | None = None
    volume_relative_sd: float = 0.0
    day_minute: int | None = None
    own: Sequence[Eaten] = ()
    eater: str | None = None


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
        """learned: the newest last. none_prior: of a food that the index does not know; None: as own examples show.

        Raises ValueError if an example's vector is not of the index's length, or not finite, or none_prior is not
        between 0 and 1.
        """
        if none_prior is not None and not 0.0 < none_prior < 1.0:
            raise ValueError(f"the share of foods that the index does not know is between 0 and 1, not {none_prior}")
        kept = newest_of_each(learned)
        self._known = _classes(index, kept)
        place = {known.food_key: number for number, known in enumerate(self._known)}
        labels = np.concatenate([index.labels, np.array([place[one.food_key] for one in kept], np.intp)])
        vectors = np.concatenate([index.vectors, *(one.vector.reshape(1, -1) for one in kept)])
        self._metric, self._calibration = index.metric, index.calibration
        self._classifier = fit_classifier(index.metric.embed(vectors), labels, len(self._known))
        own = [one for one in learned if one.is_own]  # all: shares of those kept would be alike for all foods
        self._eaten = [(one.eater, Eaten(one.food_key, one.day_minute)) for one in own[-MOST_EATEN:]]
        others = {one.food_key for one in kept if not one.is_own}
        known_without = frozenset(others | {food.food_key for food in index.foods})
        shown = new_food_share(known_without, [one.food_key for one in own])
        self._none_prior = none_prior if none_prior is not None else shown
        self.version = _version(index, learned)
        self.vcm_version = index.vcm_version

    def identify(self, vector: Vectors, circumstances: Circumstances = NOTHING_KNOWN, most: int = 10) -> Identification:
        """The likeliest foods of a region. vector: (d,) of vcm_version.

        Raises ValueError if the vector is of another length or not finite.
        """
        scores = self._classifier.scores(self._metric.embed(np.asarray(vector, np.float64).reshape(1, -1)))
        likelihoods, none = self._calibration.log_likelihoods(scores)
        at = circumstances
        sizes = [size_log_likelihood(each.size, at.volume_ml, at.volume_relative_sd) for each in self._known]
        others = [eaten for eater, eaten in self._eaten if eater is None or eater != at.eater]
        habits = log_prior([each.food_key for each in self._known], at.day_minute, at.own, others)
        shares, none_share = posterior(likelihoods + np.array(sizes), none, np.array(habits), self._none_prior)
        best = np.argsort(-shares[0], kind="stable")[:most]
        return Identification(
            tuple(self._known[i].candidate(float(shares[0, i])) for i in best),
            float(none_share[0]),
            self.version,
        )


def newest_of_each(learned: Sequence[Example], most: int = MOST_EXAMPLES) -> list[Example]:
    """At most so many examples, in their order: of each food its newest, as many as any other food has.

    learned: the newest last. Own examples go before those of others, and eaters take turns, so that nobody makes up a
    food alone. Where there are more foods than that, those of the newest examples.
    """
    of_eater: Counter[tuple[str, str | None]] = Counter()
    turns = {}
    for place in reversed(range(len(learned))):
        eater = learned[place].food_key, learned[place].eater
        turns[place] = of_eater[eater]
        of_eater[eater] += 1
    of_food: Counter[str] = Counter()
    ranks = {}
    for place in sorted(turns, key=lambda place: (not learned[place].is_own, turns[place], -place)):
        one = learned[place]
        ranks[place] = (of_food[one.food_key], not one.is_own, -place)
        of_food[one.food_key] += 1
    return [learned[place] for place in sorted(sorted(ranks, key=ranks.__getitem__)[:most])]


def _classes(index: FoodIndex, learned: Sequence[Example]) -> list[_Known]:
    """The index's foods in their order, then those that were learned beside them."""
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
    digest = hashlib.sha256()
    for one in learned:
        told = (one.name, one.food_key, one.volume_ml, one.day_minute, one.is_own, one.eater)
        digest.update(repr(told).encode() + np.asarray(one.vector, np.float64).tobytes())
    return f"{index.version} + {len(learned)} confirmed {digest.hexdigest()[:12]}"
