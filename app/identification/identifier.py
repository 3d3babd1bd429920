"""Described region and circumstances -> ranked foods with probabilities; it learns from confirmed items.

By Bayes' rule: how likely the looks (kernel_classifier, calibrate), how likely the size (sizes),
how likely that somebody eats this now (habits), each for every food that the index knows and for
none of them.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.identification.food_index import FoodIndex
from app.identification.groups import group_probabilities
from app.identification.habits import Eaten, log_prior, new_food_share
from app.identification.kernel_classifier import KernelClassifier, posterior
from app.identification.metric import Vectors
from app.identification.sizes import FoodSize, food_size, size_log_likelihood

MOST_EATEN = 1400  # of the study's items that show what is eaten at a time of day: each answer looks at all of them
# learned, beside those that ship: what one linear system solves in less than a second
MOST_EXAMPLES = 1400


@dataclass(frozen=True, slots=True)
class Example:
    """A confirmed item: vector (d,) by the index's VCM version; the rest as far as it is known.

    name: unique, for the index's version
    is_own: of the study itself, not of another that shares its index
    day_minute: after local midnight
    eater: any name of the person
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
    """What is known of an item beside its looks.

    own: the confirmed items of its eater
    day_minute: local
    """

    volume_ml: float | None = None
    volume_relative_sd: float = 0.0
    day_minute: int | None = None
    own: Sequence[Eaten] = ()
    eater: str | None = None


NO_CIRCUMSTANCES = Circumstances()


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food that it may be.

    name, label: of the shipped index, None for a food that was learned.
    specimens: pieces or servings that it is known by
    """

    name: str | None
    label: str | None
    food_key: str
    probability: float
    specimens: int


@dataclass(frozen=True, slots=True)
class Identification:
    """candidates: all foods, best first; none_probability: that it is none of them.

    groups: of foods, each in place of its members, best first; label and name None
    """

    candidates: tuple[Candidate, ...]
    groups: tuple[Candidate, ...]
    none_probability: float
    index_version: str


@dataclass(frozen=True, slots=True)
class _Known:
    """A class: a label of the shipped index, a learned food, or both."""

    food_key: str
    name: str | None
    label: str | None
    size: FoodSize | None
    specimens: int

    def candidate(self, probability: float) -> Candidate:
        return Candidate(self.name, self.label, self.food_key, probability, self.specimens)


class Identifier:
    """An index with learned examples; immutable: later examples make another."""

    def __init__(
        self,
        index: FoodIndex,
        learned: Sequence[Example] = (),
        *,
        groups: Mapping[str, Collection[str]] | None = None,
        none_prior: float | None = None,
    ) -> None:
        """learned: the newest last. groups: key -> its members' food keys.

        none_prior: probability of a food unknown to the index; None: from own examples.

        Raises ValueError if an example's vector is not of the index's length, or not finite, or
        none_prior is not between 0 and 1.
        """
        if none_prior is not None and not 0.0 < none_prior < 1.0:
            raise ValueError(
                f"the share of foods that the index does not know is between 0 and 1, not {none_prior}"
            )
        kept = newest_of_each(learned)
        self._known = _classes(index, kept)
        self._sizes = {
            known.food_key: known.size for known in self._known if known.size is not None
        }
        place = {known.food_key: number for number, known in enumerate(self._known)}
        labels = np.concatenate(
            [index.labels, np.array([place[example.food_key] for example in kept], np.intp)]
        )
        members = {
            key: np.array([known.food_key in foods for known in self._known])
            for key, foods in (groups or {}).items()
        }
        self._groups = {key: own for key, own in members.items() if own.sum() > 1}
        self._metric, self._calibration = index.metric, index.calibration
        examples = [index.examples]
        if kept:
            examples.append(self._metric.embed(np.stack([example.vector for example in kept])))
        self._classifier = KernelClassifier(np.concatenate(examples), labels, len(self._known))
        own = [
            example for example in learned if example.is_own
        ]  # all: the kept ones have equal shares by design
        self._eaten = [
            (example.eater, Eaten(example.food_key, example.day_minute))
            for example in own[-MOST_EATEN:]
        ]
        others = {example.food_key for example in kept if not example.is_own}
        known_without = frozenset(others | {food.food_key for food in index.foods})
        estimated = new_food_share(known_without, [example.food_key for example in own])
        self._none_prior = none_prior if none_prior is not None else estimated
        self.version = _version(index, learned)
        self.vcm_version = index.vcm_version

    def size_of(self, food_key: str) -> FoodSize | None:
        """Return the size of a food's next piece; None where no piece of it was measured."""
        return self._sizes.get(food_key)

    def sizes_by_looks(self, vector: Vectors) -> list[tuple[float, FoodSize]]:
        """Return the probability of each food of known size by looks alone, with its size.

        Raises as identify.
        """
        candidates = self.identify(vector).candidates
        return [
            (candidate.probability, self._sizes[candidate.food_key])
            for candidate in candidates
            if candidate.food_key in self._sizes
        ]

    def identify(
        self,
        vector: Vectors,
        circumstances: Circumstances = NO_CIRCUMSTANCES,
    ) -> Identification:
        """All foods, and how likely a region is of each.

        vector: (d,) of vcm_version, or (n, d) of several views of it

        Raises ValueError if a vector is of another length or not finite.
        """
        views = self._metric.embed(np.atleast_2d(np.asarray(vector, np.float64)))
        scores = self._classifier.scores(views).mean(axis=0)
        likelihoods, none = self._calibration.log_likelihoods(scores[None])
        volume_ml, relative_sd = circumstances.volume_ml, circumstances.volume_relative_sd
        sizes = [size_log_likelihood(known.size, volume_ml, relative_sd) for known in self._known]
        others = [
            eaten for eater, eaten in self._eaten if eater is None or eater != circumstances.eater
        ]
        foods = [known.food_key for known in self._known]
        habits = log_prior(foods, circumstances.day_minute, circumstances.own, others)
        log_odds = np.array(sizes) + np.array(habits)
        shares, none_share = posterior(likelihoods, none, log_odds, self._none_prior)
        best = np.argsort(-shares[0], kind="stable")
        return Identification(
            tuple(self._known[i].candidate(float(shares[0, i])) for i in best),
            self._group_candidates(scores, log_odds),
            float(none_share[0]),
            self.version,
        )

    def _group_candidates(self, scores: Vectors, log_odds: Vectors) -> tuple[Candidate, ...]:
        found = group_probabilities(
            scores, log_odds, self._groups, self._calibration, self._none_prior
        )
        specimens = np.array([known.specimens for known in self._known])
        return tuple(
            Candidate(None, None, key, found[key], int(specimens[self._groups[key]].sum()))
            for key in sorted(found, key=lambda key: -found[key])
        )


def newest_of_each(learned: Sequence[Example], most: int = MOST_EXAMPLES) -> list[Example]:
    """Return at most `most` examples, in their order: the newest of each food, as many as of any other food.

    learned: the newest last. Own examples come before those of other studies, and eaters take
    turns, so that no single person defines a food. If there are more foods than `most`, the foods
    of the newest examples are kept.
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
        example = learned[place]
        ranks[place] = (of_food[example.food_key], not example.is_own, -place)
        of_food[example.food_key] += 1
    return [learned[place] for place in sorted(sorted(ranks, key=ranks.__getitem__)[:most])]


def _classes(index: FoodIndex, learned: Sequence[Example]) -> list[_Known]:
    """Return the index's foods in their order, then the other learned foods."""
    volumes: dict[str, list[float]] = {}
    specimens = Counter(example.food_key for example in learned)
    for label, _ in set(zip(index.labels.tolist(), index.specimens, strict=True)):
        specimens[index.foods[label].food_key] += 1
    for example in learned:
        if example.volume_ml is not None:
            volumes.setdefault(example.food_key, []).append(example.volume_ml)
    known = []
    for food in index.foods:
        pieces = [*index.volumes_ml.get(food.label, ()), *volumes.get(food.food_key, ())]
        known.append(
            _Known(
                food.food_key,
                food.name,
                food.label,
                food_size(pieces),
                specimens[food.food_key],
            )
        )
    shipped = {food.food_key for food in index.foods}
    new = {example.food_key for example in learned} - shipped
    return known + [
        _Known(key, None, None, food_size(volumes.get(key, ())), specimens[key])
        for key in sorted(new)
    ]


def _version(index: FoodIndex, learned: Sequence[Example]) -> str:
    if not learned:
        return index.version
    digest = hashlib.sha256()
    for example in learned:
        fields = (
            example.name, example.food_key, example.volume_ml, example.day_minute, example.is_own, example.eater,
        )  # fmt: skip
        digest.update(repr(fields).encode() + np.asarray(example.vector, np.float64).tobytes())
    return f"{index.version} + {len(learned)} confirmed {digest.hexdigest()[:12]}"
