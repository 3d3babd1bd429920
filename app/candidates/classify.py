"""A second opinion on each food of a run's answer: by a network that the operator supplies, in a child of its own.

Runs in the worker after the estimate, so that a model which cannot be loaded, crashes or answers
nonsense costs a meal nothing: its candidates are then the index's alone, and
`parameters.classifier` of the run says why. `TADA_CLASSIFIER` names a TOML file that describes the
network: its file, digest, labels and input; docs/identification.md, "A network of your own", has an
example. Paths in it are relative to its folder.
"""

import csv
import hashlib
import io
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import structlog
from pydantic import Field, ValidationError

from app.children.child_pool import ChildPool, ChildRequest, ChildResult, Outcome
from app.core.errors import Failure
from app.core.settings import Settings
from app.http.closed_model import ClosedModel
from app.meals.stored.outline_json import rings_of
from app.meals.stored.run_answer import CandidateAnswer, Json, RunAnswer

log = structlog.get_logger()

CLASSIFIER_SECONDS = 30.0  # of processor time for a meal: large networks need one for each food
MOST_SEALED = 20  # per item; fewer are saved, since a table may lack some
LEAST_PROBABILITY = 0.001
DECIMALS = 6
MAX_MODEL_BYTES = 512 * 1024 * 1024
MAX_TEXT_BYTES = 1024 * 1024  # of the description and of the labels
MAX_SIDE_PX = 1024
MAX_LABELS = 10_000

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Described(ClosedModel):
    """The TOML file."""

    model: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    labels: str
    width_px: int = Field(ge=1, le=MAX_SIDE_PX)
    height_px: int = Field(ge=1, le=MAX_SIDE_PX)
    mean: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    scale: tuple[Finite, Finite, Finite] = (1 / 255, 1 / 255, 1 / 255)
    channels: Literal["rgb", "bgr"] = "rgb"
    answers: Literal["scores", "probabilities"] = "scores"
    studies: list[str] | None = None


@dataclass(frozen=True, slots=True)
class FoodClassifier:
    """A described network. food_keys: of each of its outputs, None for what is no food of a table.

    studies: codes of those whose meals it sees; None: all
    network_input: keys of vision/looks/food_model.NetworkInput
    """

    model: Path
    sha256: str
    food_keys: tuple[str | None, ...]
    network_input: dict[str, Any]
    studies: frozenset[str] | None

    @property
    def version(self) -> str:
        """Names the network in a run's parameters."""
        return f"{self.model.stem[:60]} {self.sha256[:12]}"


def read_classifier(path: Path) -> FoodClassifier | Failure:
    """Return the described network. Failure "classifier_unreadable"."""
    try:
        described = _Described.model_validate(tomllib.loads(_text(path)))
        keys = _food_keys(_text(path.parent / described.labels))
    except ValidationError as error:
        first = error.errors()[0]
        return _unreadable(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}")
    except (OSError, ValueError, csv.Error) as error:
        return _unreadable(path, str(error))
    network_input = described.model_dump(exclude={"model", "sha256", "labels", "studies"}) | {
        "labels": len(keys)
    }
    return FoodClassifier(
        model=path.parent / described.model,
        sha256=described.sha256,
        food_keys=keys,
        network_input=network_input,
        studies=None if described.studies is None else frozenset(described.studies),
    )


def read_model(path: Path, sha256: str) -> bytes | Failure:
    """Return the model's bytes, which have this digest.

    Failures "classifier_unreadable", "classifier_too_large" and "classifier_digest_differs".
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_MODEL_BYTES + 1)
    except OSError as error:
        return _unreadable(path, str(error.strerror))
    if len(content) > MAX_MODEL_BYTES:
        limit = MAX_MODEL_BYTES // 1024**2
        return Failure("classifier_too_large", f"The model {path} is larger than {limit} MiB.")
    actual = hashlib.sha256(content).hexdigest()
    if actual != sha256:
        return Failure(
            "classifier_digest_differs", f"The model {path} has the SHA-256 {actual}, not {sha256}."
        )
    return content


def _food_keys(text: str) -> tuple[str | None, ...]:
    """Lines of label and food_key, in the order of the network's outputs; an empty key is no food."""
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows or len(rows) > MAX_LABELS or any(row.get("food_key") is None for row in rows):
        raise ValueError(
            f"the labels need the columns label and food_key, and 1 to {MAX_LABELS} lines"
        )
    return tuple(row["food_key"].strip() or None for row in rows)


def _text(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(MAX_TEXT_BYTES + 1)
    if len(content) > MAX_TEXT_BYTES:
        raise ValueError(f"{path} is larger than {MAX_TEXT_BYTES // 1024} KiB")
    return content.decode()


def _unreadable(path: Path, reason: str) -> Failure:
    return Failure("classifier_unreadable", f"{path} cannot be used: {reason}.")


class ClassifyFoods:
    """The use case; one per worker process.

    The description is read for each meal: an operator may replace it.
    """

    def __init__(self, children: ChildPool, settings: Settings) -> None:
        self._children = children
        self._settings = settings

    def add_candidates(self, study_code: str, answer: RunAnswer, left: Path) -> None:
        """Set `model_candidates` of the answer's items, and `classifier` in its parameters.

        left: the photograph.

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
