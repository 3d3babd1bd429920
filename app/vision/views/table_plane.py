"""The table found in a scene without a marker: the largest plane under everything else.

Two cameras with their relative pose and their photographs -> the plane in the first camera's frame, and the table frame
that lies on it. A coarse dense match is enough: heights are measured again on the full pair, and the table's height
with them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.pictures import grey_of
from app.vision.geometry.projective import homogeneous, rotation_along
from app.vision.intrinsics import Camera
from app.vision.model import Float64Array, ImageArray, MaskArray
from app.vision.views.disparity import looks_alike

COARSE_SIDE_PX = 640  # long side of the coarse match
NEAREST_BASELINES, NEAREST_MM = 1.5, 120.0  # nearest distance searched: the larger of the two
MAX_SEARCH_SHARE = 0.6  # of the coarse width that the search may cover
DISPARITY_STEPS = 16.0  # a pixel, of OpenCV's fixed-point disparities
SMALL_STEP_PENALTY, LARGE_STEP_PENALTY, WINDOW_PX = 200, 800, 5  # Hirschmueller (2008), P1 and P2
SPECKLE_PX, SPECKLE_STEP_PX = 150, 2
MIN_SEEN_PX = 2000  # of the coarse match
NOISE_REDUCTION = 2  # of the coarse match, on which what is alike is told from noise
SAMPLES = 4000
DRAWS = 600
ON_PLANE_PX = 0.4  # of disparity: what the coarse match leaves
UNDER_PX = 1.0  # of disparity, beyond which a point surely lies under a plane
MIN_SHARE = 0.15  # of what is matched, on the largest plane; on a plain table much of it is noise
MIN_ALIKE_SHARE = 0.1  # of the coarse picture: a dish fills as much
MIN_SURE_SHARE = 0.08  # of what surely matches: foods and a dish's rim have their part of it
MIN_SHARE_UNDER = 0.1  # of what is matched, on a plane under that one
ROUNDS = 5
MAX_OFF_UP_DEG = 10.0  # of gravity, by tracking 1 degree, of tables 2; what is left is the plane of three coarse points
# between the camera's axis and the plane's normal: flatter, and it is a wall or chance
MAX_TILT_DEG = 80.0


@dataclass(frozen=True, slots=True)
class RigPose:
    """The second camera by the first: x_second = rotation @ x_first + translation_mm. (3, 3), (3,)."""

    rotation: Float64Array
    translation_mm: Float64Array


def find_table_plane(
    pictures: tuple[ImageArray, ImageArray],
    cameras: tuple[Camera, Camera],
    pose: RigPose,
    rng: np.random.Generator,
    up: Float64Array | None = None,
) -> Float64Array | Failure:
    """(4,) normal n towards the cameras and distance d of the table, n . x + d = 0 in the first camera's frame, mm.

    pictures: (H, W, 3) uint8, BGR. up: (3,) unit vector against gravity in that frame, about which a table's normal
    lies; None: not known. Failure "table_not_found".
    """
    coarse = _coarse_match(pictures, cameras, pose)
    if np.count_nonzero(coarse.is_matched) < MIN_SEEN_PX:
        return table_not_found("hardly anything on it looks alike in both photographs")
    # A weakly textured table is seen among noise; where noise hides it, what surely matches is left: a dish's floor.
    fitted = _plane_of(coarse, coarse.is_matched, MIN_SHARE, up, rng)
    if fitted is None and np.mean(coarse.is_alike) > MIN_ALIKE_SHARE:
        fitted = _plane_of(coarse, coarse.is_alike, MIN_SURE_SHARE, up, rng)
    if fitted is None:
        return table_not_found("no plane is shared by enough of what is seen")
    normal, distance = _normal_of(fitted, coarse)
    if -normal[2] < np.cos(np.radians(MAX_TILT_DEG)):
        return table_not_found("the largest plane is nearly in line with the camera")
    return np.append(coarse.rotation.T @ normal, distance)


def _plane_of(
    coarse: "_Coarse",
    is_chosen: MaskArray,
    min_share: float,
    up: Float64Array | None,
    rng: np.random.Generator,
) -> Float64Array | None:
    """lowest_plane of a sample of the chosen pixels of the coarse match, about level where up is known."""
    rows, columns = np.nonzero(is_chosen)
    chosen = rng.choice(len(rows), min(SAMPLES, len(rows)), replace=False)
    pixels = np.column_stack([columns[chosen], rows[chosen]]).astype(np.float64)
    disparity = coarse.disparity_px[rows[chosen], columns[chosen]].astype(np.float64)
    level = None if up is None else coarse.rotation @ up

    def is_level(plane: Float64Array) -> bool:
        return level is None or float(_normal_of(plane, coarse)[0] @ level) > np.cos(
            np.radians(MAX_OFF_UP_DEG)
        )

    # In a rectified pair a plane's disparity is linear in x and y, and its noise is the same everywhere.
    return lowest_plane(homogeneous(pixels), disparity, rng, min_share, is_level)


def _normal_of(plane: Float64Array, coarse: "_Coarse") -> tuple[Float64Array, float]:
    """(3,) normal in the rectified camera's frame and distance, mm, of the plane with disparity a x + b y + c."""
    # Disparity f B / Z = a x + b y + c at pixel x = f X / Z + cx, so a f X + b f Y + (a cx + b cy + c) Z = f B.
    a, b, c = plane
    centre_x, centre_y = coarse.centre_px
    normal = np.array([a * coarse.focal_px, b * coarse.focal_px, a * centre_x + b * centre_y + c])
    length = float(np.linalg.norm(normal))
    return -normal / length, coarse.focal_px * coarse.baseline_mm / length


def table_from_plane(plane: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Rotation (3, 3) and translation (3,) mm of the first camera, x_camera = rotation @ x_table + translation_mm.

    The origin lies where the first camera's axis meets the plane, x runs as its rows do, z is the plane's normal.
    plane: (4,), see find_table_plane.
    """
    normal, distance = plane[:3], plane[3]
    z_axis = normal
    x_axis = np.array([1.0, 0.0, 0.0]) - z_axis[0] * z_axis
    x_axis /= np.linalg.norm(x_axis)
    rotation = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    origin = np.array([0.0, 0.0, -distance / normal[2]])
    return rotation, origin


@dataclass(frozen=True, slots=True)
class _Coarse:
    """A rectified pair's disparity. rotation: (3, 3) first camera to rectified camera.

    is_alike: (H, W) matched where the pictures correlate, so that noise does not explain the match.
    """

    disparity_px: Float64Array
    is_matched: MaskArray
    is_alike: MaskArray
    focal_px: float
    centre_px: tuple[float, float]
    baseline_mm: float
    rotation: Float64Array


def _coarse_match(
    pictures: tuple[ImageArray, ImageArray], cameras: tuple[Camera, Camera], pose: RigPose
) -> _Coarse:
    """Disparity of the pair at reduced size, x_first - x_second in px, rows along the baseline."""
    # the second centre in the first camera's frame
    baseline = -pose.rotation.T @ pose.translation_mm
    baseline_mm = float(np.linalg.norm(baseline))
    rotation = rotation_along(baseline, np.array([0.0, 0.0, 1.0]) + pose.rotation[2])
    low, high = _turned_bounds(cameras[0], rotation)
    focal = COARSE_SIDE_PX / float((high - low).max())
    width, height = (int(np.ceil(side * focal)) for side in high - low)
    centre = -low * focal
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    turns = rotation, rotation @ pose.rotation.T
    greys, seen = [], []
    for picture, camera, turn in zip(pictures, cameras, turns, strict=True):
        maps = cv2.initUndistortRectifyMap(
            camera.matrix, np.array(camera.distortion), turn, matrix, (width, height), cv2.CV_32FC1
        )
        grey = cv2.GaussianBlur(grey_of(picture), (0, 0), max(0.5, 0.4 * camera.fx / focal))
        greys.append(np.asarray(cv2.remap(grey, *maps, cv2.INTER_LINEAR), np.uint8))
        inside = np.full(grey.shape, 255, np.uint8)
        seen.append(cv2.remap(inside, *maps, cv2.INTER_NEAREST) > 0)
    nearest_mm = max(NEAREST_MM, NEAREST_BASELINES * baseline_mm)
    most = min(focal * baseline_mm / nearest_mm, MAX_SEARCH_SHARE * width)
    steps = 16 * max(1, int(np.ceil(most / 16)))
    matcher = cv2.StereoSGBM.create(
        0,
        steps,
        WINDOW_PX,
        SMALL_STEP_PENALTY,
        LARGE_STEP_PENALTY,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=SPECKLE_PX,
        speckleRange=SPECKLE_STEP_PX,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )
    # Left of the first `steps` columns nothing is searched: a margin there keeps the picture whole.
    padded = [cv2.copyMakeBorder(grey, 0, 0, steps, 0, cv2.BORDER_CONSTANT) for grey in greys]
    disparity = (
        matcher.compute(padded[0], padded[1])[:, steps:].astype(np.float64) / DISPARITY_STEPS
    )
    is_matched = (disparity > 0) & seen[0]
    columns = np.broadcast_to(np.arange(width), disparity.shape)
    partner = np.rint(columns - disparity).astype(np.int64)
    is_matched &= (partner >= 0) & seen[1][
        np.arange(height)[:, None], np.clip(partner, 0, width - 1)
    ]
    half = (max(1, width // NOISE_REDUCTION), max(1, height // NOISE_REDUCTION))
    reduced = np.asarray(
        cv2.resize(disparity.astype(np.float32), half, interpolation=cv2.INTER_NEAREST), np.float32
    )
    alike = cv2.resize(
        looks_alike(greys[0], greys[1], reduced).astype(np.uint8),
        (width, height),
        interpolation=cv2.INTER_NEAREST,
    )
    is_alike = is_matched & (alike > 0)
    return _Coarse(
        disparity,
        is_matched,
        is_alike,
        focal,
        (float(centre[0]), float(centre[1])),
        baseline_mm,
        rotation,
    )


def _turned_bounds(camera: Camera, rotation: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(2,), (2,) least and greatest x / z, y / z of the first camera's picture after the turn."""
    corners = np.array(
        [
            [x, y]
            for x in (0.0, camera.width / 2, camera.width - 1.0)
            for y in (0.0, camera.height / 2, camera.height - 1.0)
        ]
    )
    rays = cv2.undistortPoints(
        corners[:, None], camera.matrix, np.array(camera.distortion)
    ).reshape(-1, 2)
    turned = homogeneous(np.asarray(rays, np.float64)) @ rotation.T
    turned = turned[:, :2] / turned[:, 2:]
    return turned.min(axis=0), turned.max(axis=0)


def lowest_plane(
    pixels: Float64Array,
    disparity_px: Float64Array,
    rng: np.random.Generator,
    min_share: float = MIN_SHARE,
    is_possible: Callable[[Float64Array], bool] = lambda _: True,
) -> Float64Array | None:
    """(3,) a, b, c of the disparity a x + b y + c that most points share (RANSAC), or of a parallel plane under it.

    pixels: (n, 3) homogeneous. disparity_px: (n,). is_possible: of a, b, c. None where too few share any.
    """
    most, plane = 0, None
    for _ in range(DRAWS):
        drawn = rng.choice(len(pixels), 3, replace=False)
        if abs(np.linalg.det(pixels[drawn])) < COARSE_SIDE_PX:  # nearly on one line
            continue
        candidate = np.linalg.solve(pixels[drawn], disparity_px[drawn])
        count = int(np.count_nonzero(np.abs(disparity_px - pixels @ candidate) < ON_PLANE_PX))
        if count > most and is_possible(np.asarray(candidate, np.float64)):
            most, plane = count, np.asarray(candidate, np.float64)
    if plane is None or most < min_share * len(pixels):
        return None
    return _settled(_parallel_under(plane, pixels, disparity_px), pixels, disparity_px)


def _parallel_under(
    plane: Float64Array, pixels: Float64Array, disparity_px: Float64Array
) -> Float64Array:
    """The farthest plane parallel to this one that a good part of the points share; the same one where there is none.

    A tray or a large plate may fill the picture and show more texture than the table that carries it.
    """
    expected = pixels @ plane
    is_under = (disparity_px < expected - UNDER_PX) & (expected > UNDER_PX)
    if np.count_nonzero(is_under) < 3:
        return plane
    # Parallel planes have disparities of one ratio: their distances from the camera have its inverse.
    ratios = np.sort(disparity_px[is_under] / expected[is_under])
    tolerance = ON_PLANE_PX / float(np.median(expected[is_under]))
    counts = np.searchsorted(ratios, ratios + 2 * tolerance) - np.arange(len(ratios))
    is_shared = counts >= MIN_SHARE_UNDER * len(pixels)
    return plane * (ratios[is_shared.argmax()] + tolerance) if is_shared.any() else plane


def _settled(plane: Float64Array, pixels: Float64Array, disparity_px: Float64Array) -> Float64Array:
    """The plane fitted again to the points on it."""
    for _ in range(ROUNDS):
        is_on = np.abs(disparity_px - pixels @ plane) < ON_PLANE_PX
        if np.count_nonzero(is_on) < 3:
            return plane
        plane = np.asarray(
            np.linalg.lstsq(pixels[is_on], disparity_px[is_on], rcond=None)[0], np.float64
        )
    return plane


def table_not_found(reason: str) -> Failure:
    """Return the failure, with the reason as a clause."""
    return Failure(
        "table_not_found",
        f"The table could not be found in the photographs: {reason}.",
        "Photograph the meal so that the table around the plate is in both pictures; a table or a mat with a pattern "
        "is found best.",
    )
