"""A stereo rig as a value: two cameras that are fixed to each other, from a rig file's keys.

It gives a scene its scale, so that a meal by a rig needs no marker. The API, which keeps and chooses rigs, needs no
NumPy for it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from app.core.errors import Failure, InvalidInputError
from app.vision.intrinsics import (
    Camera,
    adapt_camera,
    camera_from_mapping,
    camera_to_json,
    number_from,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ORTHONORMAL = 1e-3  # by which a rotation's rows may differ from orthogonal unit vectors: written with four digits
# of the baseline along the right camera's axis: beyond, no rows can be aligned
MAX_FORWARD_SHARE = 0.7
MIN_BASELINE_MM, MAX_BASELINE_MM = 1.0, 1000.0
Row = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StereoRig:
    """Two cameras and the pose of the right one: x_right = rotation @ x_left + translation_mm.

    source: "rig", calibrated; "poses", of one phone's tracking, which is less exact; "object", of matches, in the scale
    of a known object. up: unit vector against gravity
    in the left camera's frame; None: not known.
    """

    left: Camera
    right: Camera
    rotation: tuple[Row, Row, Row]
    translation_mm: Row
    source: Literal["rig", "poses", "object"] = "rig"
    up: Row | None = None

    @property
    def baseline_mm(self) -> float:
        """Distance between the camera centres."""
        return math.hypot(*self.translation_mm)

    @property
    def right_from_left(self) -> "NDArray[np.float64]":
        """(3, 3) the nearest rotation matrix to the digits of the file."""
        import numpy as np  # noqa: PLC0415  # the API process has rigs, and no NumPy

        left_vectors, _, right_vectors = np.linalg.svd(np.array(self.rotation, np.float64))
        return np.asarray(left_vectors @ right_vectors, np.float64)


def rig_to_json(rig: StereoRig) -> dict[str, Any]:
    """Return a rig with the keys of a rig file; each camera with its own size."""
    return {
        "left": camera_to_json(rig.left),
        "right": camera_to_json(rig.right),
        "R": [list(row) for row in rig.rotation],
        "t_mm": list(rig.translation_mm),
    }


def adapt_rig(
    rig: StereoRig, left_size: tuple[int, int], right_size: tuple[int, int]
) -> tuple[Camera, Camera] | Failure:
    """The rig's cameras for photographs of these sizes, (width, height): the rig's own size or scaled by one ratio.

    Failure "camera_mismatch" for any other size. A photograph turned by a quarter is refused as well: the pose between
    the cameras holds for the images as the rig was calibrated.
    """
    cameras = []
    for side, camera, (width, height) in (
        ("left", rig.left, left_size),
        ("right", rig.right, right_size),
    ):
        is_turned = (camera.width > camera.height) != (
            width > height
        ) and camera.width != camera.height
        adapted = None if is_turned else adapt_camera(camera, width, height)
        if adapted is None or isinstance(adapted, Failure):
            return Failure(
                "camera_mismatch",
                f"The rig's {side} camera takes {camera.width} x {camera.height} px, the {side} photograph has "
                f"{width} x {height} px, which is neither that size nor it scaled.",
                "Send both photographs as the rig's cameras take them, without turning or cropping, or calibrate the "
                "rig anew.",
            )
        cameras.append(adapted)
    return cameras[0], cameras[1]


def rig_from_mapping(data: object) -> StereoRig:
    """A StereoRig from parsed JSON: width, height, left and right (fx, fy, cx, cy, distortion), R (3 x 3), t_mm (3).

    left and right may have a width and a height of their own. Other keys are ignored. Raises InvalidInputError, code
    "rig_invalid"; "camera_invalid" for a camera that cannot be.
    """
    if not isinstance(data, Mapping):
        raise _invalid("it must be an object with width, height, left, right, R and t_mm.")
    if missing := [key for key in ("left", "right", "R", "t_mm") if key not in data]:
        raise _invalid("it lacks " + ", ".join(missing) + ".")
    shared = {key: data[key] for key in ("width", "height") if key in data}
    cameras = []
    for side in ("left", "right"):
        if not isinstance(data[side], Mapping):
            raise _invalid(f"{side} must be an object with fx, fy, cx, cy and distortion.")
        cameras.append(camera_from_mapping({**shared, **data[side]}))
    rows = data["R"]
    if not isinstance(rows, list | tuple) or len(rows) != 3:
        raise _invalid("R must be a list of three rows.")
    rotation = (_triple(rows[0], "R"), _triple(rows[1], "R"), _triple(rows[2], "R"))
    if not is_rotation(rotation):
        raise _invalid("R is no rotation matrix: x_right = R x_left + t_mm.")
    rig = StereoRig(cameras[0], cameras[1], rotation, _triple(data["t_mm"], "t_mm"))
    if not MIN_BASELINE_MM <= rig.baseline_mm <= MAX_BASELINE_MM:
        raise _invalid(
            f"its cameras are {rig.baseline_mm:g} mm apart; t_mm is in millimetres, and {MIN_BASELINE_MM:g} to "
            f"{MAX_BASELINE_MM:g} are possible."
        )
    if abs(rig.translation_mm[2]) > MAX_FORWARD_SHARE * rig.baseline_mm:
        raise _invalid("its cameras are one behind the other; t_mm runs mainly along x or y.")
    return rig


def is_rotation(rows: tuple[Row, Row, Row]) -> bool:
    """Return whether the rows are those of a rotation matrix, up to ORTHONORMAL."""
    products = [
        sum(a * b for a, b in zip(first, second, strict=True)) for first in rows for second in rows
    ]
    is_orthonormal = all(
        abs(product - (1.0 if place % 4 == 0 else 0.0)) <= ORTHONORMAL
        for place, product in enumerate(products)
    )
    (a, b, c), (d, e, f), (g, h, i) = rows
    return is_orthonormal and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0


def numbers_from(
    value: object, count: int, key: str, invalid: Callable[[str], InvalidInputError]
) -> tuple[float, ...]:
    """So many finite numbers of a JSON list. Raises what `invalid` makes of the reason."""
    if not isinstance(value, list | tuple) or len(value) != count:
        raise invalid(f"{key} must have {count} numbers in each list.")
    return tuple(number_from(number, key, invalid) for number in value)


def _triple(value: object, key: str) -> Row:
    x, y, z = numbers_from(value, 3, key, _invalid)
    return x, y, z


def _invalid(reason: str) -> InvalidInputError:
    return InvalidInputError(f"The rig cannot be used: {reason}", code="rig_invalid")
