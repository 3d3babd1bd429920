"""A depth camera and the size of its maps; without NumPy and OpenCV, which the API's process does not load."""

from collections.abc import Mapping
from dataclasses import dataclass

from app.core.errors import Failure, InvalidInputError
from app.vision.intrinsics import CAMERA_KEYS, Camera, camera_from_mapping, number_from

DEFAULT_UNIT_MM = 0.1
MIN_SIDE_PX, MAX_SIDE_PX = 32, 8192


@dataclass(frozen=True, slots=True)
class DepthCamera(Camera):
    """A depth camera, a pinhole without distortion, px of its map; unit_mm: of whole numbers in its PNG."""

    unit_mm: float = DEFAULT_UNIT_MM


def depth_camera_from_mapping(data: object) -> DepthCamera:
    """A depth camera from parsed JSON: width, height, fx, fy, cx, cy, and unit_mm (DEFAULT_UNIT_MM).

    Other keys are ignored, such as a distortion. Raises InvalidInputError, code "depth_camera_invalid".
    """
    values = data if isinstance(data, Mapping) else {}
    camera = camera_from_mapping(
        {key: values[key] for key in CAMERA_KEYS if key in values}, _invalid
    )
    unit_mm = number_from(values.get("unit_mm", DEFAULT_UNIT_MM), "unit_mm", _invalid)
    if unit_mm <= 0:
        raise _invalid("unit_mm must be positive.")
    return DepthCamera(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, unit_mm=unit_mm
    )


def _invalid(reason: str) -> InvalidInputError:
    return InvalidInputError(
        f"The depth camera cannot be used: {reason} It has the intrinsics of the map, not of the photograph.",
        code="depth_camera_invalid",
    )


def size_mismatch(width: int, height: int, camera: DepthCamera) -> Failure | None:
    """Failure "depth_mismatch" of a map, px, that is not the camera's, or impossible."""
    sides = sorted((width, height))
    if (
        (width, height) == (camera.width, camera.height)
        and sides[0] >= MIN_SIDE_PX
        and sides[1] <= MAX_SIDE_PX
    ):
        return None
    return Failure(
        "depth_mismatch",
        f"The map has {width} x {height} px, the depth camera {camera.width} x {camera.height}; a side has "
        f"{MIN_SIDE_PX} to {MAX_SIDE_PX}.",
        "Send the intrinsics of the depth map as it is.",
    )
