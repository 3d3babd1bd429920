"""Checks of what a phone sends or is about to send: a pair before it is sent, each file as it arrives."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pydantic import BaseModel

from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.estimates.estimate_json import failure_to_json
from app.meals.run_answer import Json
from app.vision import precheck
from app.vision.depth_camera import depth_camera_from_mapping
from app.vision.depth_map import read_confidence, read_depth
from app.vision.intrinsics import camera_from_mapping
from app.vision.marker_spec import parse_marker
from app.vision.photo import ReducedPhoto, read_reduced_photo, why_not_whole


class _CheckRequest(BaseModel):
    """left, right: paths of both photographs."""

    left: Path
    right: Path
    max_pixels: int
    marker: str
    camera: Json | None


class _WholeRequest(BaseModel):
    """depth_camera: the file is a depth map of it, or its confidence map."""

    photo: Path
    depth_camera: dict[str, float] | None = None
    is_confidence: bool = False


def check_task(arguments: Arguments, _: StageListener) -> Json:
    """Judge a pair before it is sent."""
    request = _CheckRequest.model_validate(arguments)

    def read(path: Path) -> ReducedPhoto | Failure:
        return read_reduced_photo(
            path.read_bytes(), max_pixels=request.max_pixels, least_long_side_px=precheck.LEAST_LONG_SIDE_PX
        )

    with ThreadPoolExecutor(2) as threads:  # decoders let go of the interpreter
        left, right = threads.map(read, (request.left, request.right))
    camera = camera_from_mapping(request.camera) if request.camera is not None else None
    judged = precheck.check_pair(left, right, parse_marker(request.marker), camera)
    return {
        "ok": judged.is_ok,
        "problems": [{"code": each.code, "severity": each.severity, "side": each.side} for each in judged.problems],
        "measures": dict(judged.measures),
    }


def whole_task(arguments: Arguments, _: StageListener) -> Json:
    """Return whether a JPEG gives all of its pixels, or a depth or confidence map can be used."""
    request = _WholeRequest.model_validate(arguments)
    data = request.photo.read_bytes()
    if request.depth_camera is None:
        failure = why_not_whole(data)
    else:
        camera = depth_camera_from_mapping(request.depth_camera)
        read = read_confidence(data, camera) if request.is_confidence else read_depth(data, camera)
        failure = read if isinstance(read, Failure) else None
    return {"failure": failure_to_json(failure) if failure is not None else None}
