"""Camera poses that a phone's tracking gave (ARKit, ARCore) as a value, and the stereo rig that two of them make.

The scale is then the tracking's. The API, which keeps poses, needs no NumPy for it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from app.core.errors import Failure, InvalidInputError
from app.vision.intrinsics import Camera, adapt_camera
from app.vision.rig import Row, StereoRig, is_rotation, numbers_from

Convention = Literal["arkit", "arcore", "opencv"]
CONVENTIONS: tuple[Convention, ...] = get_args(Convention)
SIDES = ("left", "right")
# tracking is off by millimetres: nearer, it tells no scale
MIN_BASELINE_MM, MAX_BASELINE_MM = 20.0, 1000.0
MM_PER_M = 1000.0
UP = (0.0, 1.0, 0.0)  # of ARKit's world and ARCore's
QUARTER_TURNS = {
    3: 2,
    6: 1,
    8: 3,
}  # EXIF orientation -> quarter turns clockwise that make the stored picture upright


@dataclass(frozen=True, slots=True)
class ViewPose:
    """Camera to world: x_world = rotation @ x_camera + centre_m."""

    rotation: tuple[Row, Row, Row]
    centre_m: Row


@dataclass(frozen=True, slots=True)
class KnownPoses:
    """Poses of left and right in one world, in the camera axes of the convention (docs/apps.md).

    up: unit vector of the world; None: not known.
    """

    convention: Convention
    left: ViewPose
    right: ViewPose
    up: Row | None


def poses_from_mapping(data: object) -> KnownPoses:
    """Poses from parsed JSON: convention, views (left and right, each 4 x 4 camera to world, m), gravity [x, y, z].

    gravity points down, in the world's axes, of any length; without it up is y of ARKit's and ARCore's worlds, and
    not known of OpenCV's. Other keys are ignored. Raises InvalidInputError, code "poses_invalid".
    """
    if not isinstance(data, Mapping) or not isinstance(views := data.get("views"), Mapping):
        raise _invalid("they must be an object with convention and views.")
    convention = next((each for each in CONVENTIONS if each == data.get("convention")), None)
    if convention is None:
        raise _invalid(f"convention is one of {', '.join(CONVENTIONS)}.")
    if missing := [side for side in SIDES if side not in views]:
        raise _invalid(f"views lacks {' and '.join(missing)}.")
    left, right = (_pose(views[side], side) for side in SIDES)
    gravity, up = data.get("gravity"), None if convention == "opencv" else UP
    if gravity is not None:
        x, y, z = numbers_from(gravity, 3, "gravity", _invalid)
        length = math.hypot(x, y, z)
        if not 0.0 < length < math.inf:
            raise _invalid("gravity has no direction.")
        up = (-x / length, -y / length, -z / length)
    baseline_mm = MM_PER_M * math.dist(left.centre_m, right.centre_m)
    if not MIN_BASELINE_MM <= baseline_mm <= MAX_BASELINE_MM:
        raise _invalid(
            f"the cameras are {baseline_mm:g} mm apart; positions are in metres, and {MIN_BASELINE_MM:g} to "
            f"{MAX_BASELINE_MM:g} mm are possible."
        )
    return KnownPoses(convention, left, right, up)


def poses_to_json(poses: KnownPoses) -> dict[str, object]:
    """The reverse of poses_from_mapping."""
    views = {
        side: [
            *([*row, shift] for row, shift in zip(pose.rotation, pose.centre_m, strict=True)),
            [0.0, 0.0, 0.0, 1.0],
        ]
        for side, pose in (("left", poses.left), ("right", poses.right))
    }
    gravity = [-each for each in poses.up] if poses.up is not None else None
    return {"convention": poses.convention, "views": views, "gravity": gravity}


def rig_of_poses(
    poses: KnownPoses,
    camera: Camera,
    sizes: tuple[tuple[int, int], tuple[int, int]],
    orientations: tuple[int, int],
) -> StereoRig | Failure:
    """The rig of upright photographs of these sizes, (width, height), that one camera took at the poses.

    orientations: EXIF's, of the stored files. ARKit's and ARCore's camera axes are those of the stored picture, which
    the orientation turns; OpenCV's are the upright photograph's. Failure "camera_mismatch".
    """
    cameras = [adapt_camera(camera, *size) for size in sizes]
    left, right = cameras
    if isinstance(left, Failure):
        return left
    if isinstance(right, Failure):
        return right
    worlds = [
        _camera_from_world(pose, poses.convention, orientation)
        for pose, orientation in zip((poses.left, poses.right), orientations, strict=True)
    ]
    rotation = _times(worlds[1], _transposed(worlds[0]))
    step = tuple(
        MM_PER_M * (a - b) for a, b in zip(poses.left.centre_m, poses.right.centre_m, strict=True)
    )
    up = _turned(worlds[0], poses.up) if poses.up is not None else None
    return StereoRig(
        left, right, rotation, _turned(worlds[1], (step[0], step[1], step[2])), "poses", up
    )


Matrix = tuple[Row, Row, Row]


def _camera_from_world(pose: ViewPose, convention: Convention, orientation: int) -> Matrix:
    """Rotation into the upright photograph's camera frame, x right, y down, z forwards."""
    x, y, z = _transposed(pose.rotation)
    if convention == "opencv":
        return x, y, z
    y, z = _scaled(y, -1.0), _scaled(z, -1.0)
    # clockwise: what pointed up points right, what right down
    for _ in range(QUARTER_TURNS.get(orientation, 0)):
        x, y = _scaled(y, -1.0), x
    return x, y, z


def _transposed(rows: Matrix) -> Matrix:
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a, d, g), (b, e, h), (c, f, i)


def _scaled(row: Row, factor: float) -> Row:
    return factor * row[0], factor * row[1], factor * row[2]


def _turned(rotation: Matrix, vector: Row) -> Row:
    x, y, z = (sum(a * b for a, b in zip(row, vector, strict=True)) for row in rotation)
    return x, y, z


def _times(first: Matrix, second: Matrix) -> Matrix:
    columns = _transposed(second)
    return _transposed(
        (_turned(first, columns[0]), _turned(first, columns[1]), _turned(first, columns[2]))
    )


def _pose(value: object, side: str) -> ViewPose:
    if not isinstance(value, list | tuple) or len(value) != 4:
        raise _invalid(f"the pose of {side} must have four rows.")
    rows = [numbers_from(row, 4, side, _invalid) for row in value]
    if any(
        abs(number - expected) > 1e-6
        for number, expected in zip(rows[3], (0.0, 0.0, 0.0, 1.0), strict=True)
    ):
        raise _invalid(f"the last row of {side} must be 0, 0, 0, 1: matrices are row by row.")
    rotation = tuple((row[0], row[1], row[2]) for row in rows[:3])
    turn: Matrix = (rotation[0], rotation[1], rotation[2])
    if not is_rotation(turn):
        raise _invalid(f"the pose of {side} holds no rotation matrix.")
    return ViewPose(turn, (rows[0][3], rows[1][3], rows[2][3]))


def _invalid(reason: str) -> InvalidInputError:
    return InvalidInputError(f"The poses cannot be used: {reason}", code="poses_invalid")
