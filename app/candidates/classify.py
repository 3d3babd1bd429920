"""A second opinion on each food of a run's answer: by a network that the operator supplies, in a child of its own.

Runs in the worker after the estimate, so that a model which cannot be loaded, crashes or answers nonsense costs a meal
nothing: its candidates are then the index's alone, and `parameters.classifier` of the run says why.
"""

from collections.abc import Sequence
from pathlib import Path

import structlog

from app.candidates.classifier_file import FoodClassifier, read_classifier
from app.children.child_pool import ChildPool, ChildRequest, ChildResult, Outcome
from app.core.errors import Failure
from app.core.settings import Settings
from app.meals.stored.outline_json import rings_of
from app.meals.stored.run_answer import CandidateAnswer, Json, RunAnswer

log = structlog.get_logger()

CLASSIFIER_SECONDS = 30.0  # of processor time for a meal: large networks need one for each food
MOST_SEALED = 20  # per item; fewer are saved, since a table may lack some
LEAST_PROBABILITY = 0.001
DECIMALS = 6


class ClassifyFoods:
    """The use case; one per worker process. The description is read for each meal: an operator may replace it."""

    def __init__(self, children: ChildPool, settings: Settings) -> None:
        self._children = children
        self._settings = settings

    def add_candidates(self, study_code: str, answer: RunAnswer, left: Path) -> None:
        """Set `model_candidates` of the answer's items, and `classifier` in its parameters. left: the photograph.

        Raises ChildPoolClosedError and ChildStartError, which say nothing of the model.
        """
        path = self._settings.classifier
        if path is None or not answer.items:
            return
        classifier = read_classifier(path)
        if isinstance(classifier, Failure):
            _note(answer, None, classifier)
            return
        if classifier.studies is not None and study_code not in classifier.studies:
            return
        request = classify_request(
            classifier,
            left,
            [[list(map(list, ring)) for ring in rings_of(item.polygon)] for item in answer.items],
            max_pixels=self._settings.max_photo_pixels,
            colour=answer.colour.get("left") if answer.colour is not None else None,
        )
        ended = self._children.run(request, lambda _: None, seconds=CLASSIFIER_SECONDS)
        failure = failure_of(ended)
        if failure is None:
            for item, probabilities in zip(
                answer.items, ended.result["probabilities"], strict=True
            ):
                if probabilities is not None:
                    item.model_candidates = _candidates(classifier, probabilities)
        _note(answer, classifier.version, failure)


def classify_request(
    classifier: FoodClassifier,
    photo: Path,
    regions: Sequence[list[list[list[float]]]],
    *,
    max_pixels: int,
    colour: object = None,
) -> ChildRequest:
    """A child's task: this network on regions of one photograph, (rings of px); without a region, it is only loaded."""
    return ChildRequest(
        task="classify",
        arguments={
            "photo": str(photo),
            "max_pixels": max_pixels,
            "regions": list(regions),
            "colour": colour,
            "model": str(classifier.model),
            "sha256": classifier.sha256,
            "network_input": classifier.network_input,
        },
    )


def failure_of(ended: ChildResult) -> Failure | None:
    """Why a classify request has no result."""
    if ended.outcome == "ok":
        failure = ended.result["failure"]
        return None if failure is None else Failure(failure["code"], failure["message"])
    return _failure_of_outcome(ended.outcome, ended.limit)


def _failure_of_outcome(outcome: Outcome, limit: str) -> Failure:
    if outcome == "out_of_memory":
        return Failure("classifier_out_of_memory", f"The model needed more than {limit} of memory.")
    if outcome in ("timed_out", "stalled"):
        return Failure("classifier_timed_out", f"The model took more than {limit}.")
    return Failure("classifier_crashed", "The process that ran the model broke off.")


def _candidates(
    classifier: FoodClassifier, probabilities: Sequence[float]
) -> list[CandidateAnswer]:
    """The likeliest foods; labels of one food add up, and what is no food is left out."""
    by_key: dict[str, float] = {}
    for key, probability in zip(classifier.food_keys, probabilities, strict=True):
        if key is not None:
            by_key[key] = by_key.get(key, 0.0) + probability
    best = sorted(by_key.items(), key=lambda each: (-each[1], each[0]))[:MOST_SEALED]
    return [
        CandidateAnswer(food=key, probability=round(min(share, 1.0), DECIMALS))
        for key, share in best
        if share >= LEAST_PROBABILITY
    ]


def _note(answer: RunAnswer, version: str | None, failure: Failure | None) -> None:
    """Keep in the run which network looked at it, or why none did."""
    note: Json = {"version": version, "failure": failure.code if failure is not None else None}
    answer.parameters["classifier"] = note
    if failure is not None:
        log.warning("classifier_failed", code=failure.code, message=failure.message)
