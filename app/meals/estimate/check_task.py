"""Check a pair before it is sent."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pydantic import BaseModel

from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.stored.run_answer import Json
from app.vision import precheck
from app.vision.intrinsics import camera_from_mapping
from app.vision.marker_spec import parse_marker
from app.vision.photo import ReducedPhoto, read_reduced_photo


class _CheckRequest(BaseModel):
    """left, right: paths of both photographs."""

    left: Path
    right: Path
    max_pixels: int
    marker: str
    camera: Json | None


def check_task(arguments: Arguments, _: StageListener) -> Json:
    """Judge a pair before it is sent."""
    request = _CheckRequest.model_validate(arguments)

    def read(path: Path) -> ReducedPhoto | Failure:
        return read_reduced_photo(
            path.read_bytes(),
            max_pixels=request.max_pixels,
            least_long_side_px=precheck.LEAST_LONG_SIDE_PX,
        )

    with ThreadPoolExecutor(2) as threads:  # decoders let go of the interpreter
        left, right = threads.map(read, (request.left, request.right))
    camera = camera_from_mapping(request.camera) if request.camera is not None else None
    judged = precheck.check_pair(left, right, parse_marker(request.marker), camera)
    return {
        "ok": judged.is_ok,
        "problems": [
            {"code": each.code, "severity": each.severity, "side": each.side}
            for each in judged.problems
        ],
        "measures": dict(judged.measures),
    }
