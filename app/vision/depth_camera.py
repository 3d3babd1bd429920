"""A depth camera and the size of its maps; without NumPy and OpenCV, which the API's process does not load."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.core.errors import Failure, InvalidInputError

DEFAULT_UNIT_MM = 0.1
MIN_SIDE_PX, MAX_SIDE_PX = 32, 8192
MIN_FOCAL, MAX_FOCAL = 0.1, 20.0  # long sides of the map, as of cameras (intrinsics.py)
CAMERA_KEYS = ("width", "height", "fx", "fy", "cx", "cy")


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """A depth camera's pinhole, px; unit_mm: of whole numbers in its PNG."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    unit_mm: float = DEFAULT_UNIT_MM


def depth_camera_from_mapping(value: Mapping[str, Any]) -> DepthCamera:
    """A depth camera of its file's keys. Raises InvalidInputError."""
    try:
        numbers = {key: float(value[key]) for key in CAMERA_KEYS}
        unit_mm = float(value.get("unit_mm", DEFAULT_UNIT_MM))
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InvalidInputError(
            f"The depth camera needs {', '.join(CAMERA_KEYS)}, and may have unit_mm.", code="depth_camera_invalid"
        ) from None
    sizes = [numbers[key] for key in ("width", "height", "fx", "fy")]
    if not all(map(math.isfinite, [*numbers.values(), unit_mm])) or min(*sizes, unit_mm) <= 0:
        raise InvalidInputError("The depth camera's sizes and focal lengths are positive.", code="depth_camera_invalid")
    long_side = max(numbers["width"], numbers["height"])
    is_within = 0 <= numbers["cx"] <= numbers["width"] and 0 <= numbers["cy"] <= numbers["height"]
    if not is_within or any(not MIN_FOCAL <= numbers[key] / long_side <= MAX_FOCAL for key in ("fx", "fy")):
        raise InvalidInputError(
            f"The depth camera's focal lengths are {MIN_FOCAL:g} to {MAX_FOCAL:g} times the map's long side and its "
            "middle lies within the map: send the intrinsics of the map, not of the photograph.",
            code="depth_camera_invalid",
        )
    width, height = int(numbers.pop("width")), int(numbers.pop("height"))
    return DepthCamera(width, height, **numbers, unit_mm=unit_mm)


def size_mismatch(width: int, height: int, camera: DepthCamera) -> Failure | None:
    """Failure "depth_mismatch" of a map, px, that is not the camera's, or impossible."""
    sides = sorted((width, height))
    if (width, height) == (camera.width, camera.height) and sides[0] >= MIN_SIDE_PX and sides[1] <= MAX_SIDE_PX:
        return None
    return Failure(
        "depth_mismatch",
        f"The map has {width} x {height} px, the depth camera {camera.width} x {camera.height}; a side has "
        f"{MIN_SIDE_PX} to {MAX_SIDE_PX}.",
        "Send the intrinsics of the depth map as it is.",
    )
