"""What the child process does: everything that decodes uploaded bytes. JSON in, JSON out, files by path."""

import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from app.errors import Failure
from app.services.estimate_json import estimate_to_json, failure_to_json, options_from_json
from app.vision.model import EstimateOptions, MealEstimate, PhotoPair
from app.vision.photo import read_photo
from app.vision.pipeline import PIPELINE_VERSION, estimate_meal

StageListener = Callable[[str], None]


def estimate_task(request: Mapping[str, Any], on_stage: StageListener) -> dict[str, Any]:
    """Estimate a meal from two files; artefacts are written to output_dir and listed in the answer.

    request: left, right, output_dir (paths), options (estimate_json), max_pixels.
    """
    options = options_from_json(request["options"])
    output = Path(request["output_dir"])
    answer, estimate = run_estimate(
        Path(request["left"]),
        Path(request["right"]),
        options,
        max_pixels=int(request["max_pixels"]),
        on_stage=on_stage,
        want_artefacts=True,
    )
    listed = []
    for artefact in estimate.artefacts if estimate is not None else ():
        (output / artefact.name).write_bytes(artefact.content)
        listed.append(
            {
                "name": artefact.name,
                "media_type": artefact.media_type,
                "bytes": len(artefact.content),
                "sha256": hashlib.sha256(artefact.content).hexdigest(),
            }
        )
    return answer | {"artefacts": listed}


def run_estimate(
    left: Path,
    right: Path,
    options: EstimateOptions,
    *,
    max_pixels: int,
    on_stage: StageListener,
    want_artefacts: bool,
) -> tuple[dict[str, Any], MealEstimate | None]:
    """Read both photographs and run the pipeline: the answer as JSON, and the estimate unless reading failed.

    Raises OSError if a file cannot be read.
    """
    started = time.perf_counter()
    on_stage("read")
    photos = []
    for side, path in (("left", left), ("right", right)):
        photo = read_photo(path.read_bytes(), max_pixels=max_pixels)
        if isinstance(photo, Failure):
            failure = Failure(photo.code, f"The {side} photograph: {photo.message}", photo.advice)
            return _unread(failure, options, time.perf_counter() - started), None
        photos.append(photo)
    read_seconds = time.perf_counter() - started
    estimate = estimate_meal(PhotoPair(*photos), options, on_stage=on_stage, want_artefacts=want_artefacts)
    answer = estimate_to_json(estimate, options)
    answer["stages"] = {"read": round(read_seconds, 4), **answer["stages"]}
    answer["seconds"] = round(time.perf_counter() - started, 4)
    return answer, estimate


def _unread(failure: Failure, options: EstimateOptions, seconds: float) -> dict[str, Any]:
    """The answer where a photograph could not be read: the pipeline never began."""
    answer = estimate_to_json(
        MealEstimate(method=options.method, pipeline_version=PIPELINE_VERSION, stages={"read": seconds}), options
    )
    return answer | {"failure": failure_to_json(failure)}


TASKS: Mapping[str, Callable[[Mapping[str, Any], StageListener], dict[str, Any]]] = {"estimate": estimate_task}
