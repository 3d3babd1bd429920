"""Two photographs with a coin in both: their relative pose by matches, in units that the coin gives.

Photographs, cameras, the coin's ellipses -> StereoRig; and views refined over the table -> the same in
the coin's scale, with its doubts. A circle says nothing of how a camera is turned about its axis, so
that the relative pose is that of the essential matrix (Nister, 2004).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.round_object import Ellipse
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.model import Float64Array, PhotoPair, View
from app.vision.rig import MAX_BASELINE_MM, MIN_BASELINE_MM, StereoRig
from app.vision.views.features import (
    MATCHING_SIDE_PX,
    UNPLACED_FINER,
    match_unplaced,
    too_few_matches,
    triangulate,
    undistort_to_rays,
)
from app.vision.views.object_view import focal_sd, normal_of, size_sd, zoomed
from app.vision.views.relative_pose import RefinedViews

ON_LINE_PX = 1.0  # from an epipolar line, where features are looked for
CONFIDENCE = 0.9999
MIN_INLIERS = 20
MOST_COINS = 8  # in both photographs that may be it
FLATTENED_SD = (
    0.06  # log of the half-axes' ratio of a coin on a table that is tilted by some degrees
)
LEAST_ROUND = -4.5  # of both: less round, and the table or the poses are wrong
OFF_SD = 0.2  # of a coin's radius, between where two ellipses put its middle
SIZE_RATIO_SD = 0.08  # between the distances that they tell


@dataclass(frozen=True, slots=True)
class ObjectRig:
    """The rig that two photographs make. coins: what may be the coin, left and right, with its log odds, best first."""

    rig: StereoRig
    coins: tuple[tuple[float, Ellipse, Ellipse], ...]


def rig_of_object(
    pair: PhotoPair,
    cameras: tuple[Camera, Camera],
    candidates: tuple[Sequence[Ellipse], Sequence[Ellipse]],
    known: KnownObject,
) -> ObjectRig | Failure:
    """Return the rig by the likeliest ellipses that are one thing in both photographs.

    candidates: of the coin, in the left and the right photograph. Failure "too_few_matches".
    """
    views = [
        View(photo, camera, None, np.eye(3), np.zeros(3), 0.0)
        for photo, camera in zip(pair.both, cameras, strict=True)
    ]
    left_px, right_px = match_unplaced(pair.both)
    if len(left_px) < MIN_INLIERS:
        return too_few_matches(len(left_px))
    left_rays, right_rays = (
        undistort_to_rays(view, pixels)
        for view, pixels in zip(views, (left_px, right_px), strict=True)
    )
    px_per_side = max(
        1.0, max(pair.left.pixels_bgr.shape[:2]) / (UNPLACED_FINER * MATCHING_SIDE_PX)
    )
    cv2.setRNGSeed(0)
    essential, _ = cv2.findEssentialMat(
        left_rays,
        right_rays,
        np.eye(3),
        method=cv2.USAC_MAGSAC,
        prob=CONFIDENCE,
        threshold=ON_LINE_PX * px_per_side / cameras[0].fx,
    )
    if essential is None or essential.shape != (3, 3):
        return too_few_matches(0)
    count, rotation, shift, _ = cv2.recoverPose(essential, left_rays, right_rays, np.eye(3))
    if count < MIN_INLIERS:
        return too_few_matches(int(count))
    turn, step = np.asarray(rotation, np.float64), np.asarray(shift, np.float64).ravel()
    coins: list[tuple[float, Ellipse, Ellipse]] = []
    baselines: list[float] = []
    for left, right in product(*candidates):
        judged = _as_one(views, (left, right), turn, step, known.diameter_mm / 2)
        if judged is not None and MIN_BASELINE_MM < judged[1] < MAX_BASELINE_MM:
            coins.append((judged[0], left, right))
            baselines.append(judged[1])
    if not coins:
        return too_few_matches(int(count))
    order = np.argsort([-coin[0] for coin in coins])
    x, y, z = (baselines[int(order[0])] * step).tolist()
    first, second, third = ((float(row[0]), float(row[1]), float(row[2])) for row in turn)
    best = coins[int(order[0])]
    up_x, up_y, up_z = normal_of(pair.left, cameras[0], best[1], known).tolist()
    rig = StereoRig(*cameras, (first, second, third), (x, y, z), "object", (up_x, up_y, up_z))
    return ObjectRig(rig, tuple(coins[number] for number in order[:MOST_COINS]))


def _as_one(
    views: Sequence[View],
    ellipses: Sequence[Ellipse],
    rotation: Float64Array,
    step: Float64Array,
    radius_mm: float,
) -> tuple[float, float] | None:
    """Return the log odds that two ellipses are the coin, and the baseline, mm, that they give; None if they are apart.

    A circle's larger half-axis tells its distance, whatever its tilt.
    """
    rays = [
        undistort_to_rays(view, ellipse.centre_px[None])
        for view, ellipse in zip(views, ellipses, strict=True)
    ]
    place = cv2.triangulatePoints(
        np.eye(3, 4), np.column_stack([rotation, step]), rays[0].T, rays[1].T
    ).ravel()
    first = place[:3] / place[3]
    second = rotation @ first + step
    if not (first[2] > 0 and second[2] > 0):
        return None
    log_odds = 0.0
    log_baselines = []
    for view, ellipse, ray, point in zip(views, ellipses, rays, (first, second), strict=True):
        off_px = float(np.linalg.norm(point[:2] / point[2] - ray)) * view.camera.fx
        log_odds += ellipse.odds - 0.5 * (off_px / ellipse.radius_px / OFF_SD) ** 2
        distance_mm = view.camera.fx * radius_mm / float(ellipse.half_px.max())
        log_baselines.append(float(np.log(distance_mm / point[2])))
    log_odds -= 0.5 * ((log_baselines[0] - log_baselines[1]) / SIZE_RATIO_SD) ** 2
    return log_odds, float(np.exp(np.mean(log_baselines)))


def in_scale(
    refined: RefinedViews,
    coins: Sequence[tuple[float, Ellipse, Ellipse]],
    known: KnownObject,
) -> RefinedViews | Failure:
    """Return views over the table in the coin's scale, the table frame's origin under its middle.

    coins: log odds and ellipses, px of the first and the second view's photographs. What lies flat on the table is a
    circle there, in both views of the same size. Failure "marker_not_found".
    """
    views = refined.first, refined.second
    cast = []
    for log_odds, *ellipses in coins:
        places = [ellipse.centre_px[None] for ellipse in ellipses]
        level_mm = float(triangulate(*views, *places)[0, 2])
        circles = [
            _on_level(view, ellipse, level_mm)
            for view, ellipse in zip(views, ellipses, strict=True)
        ]
        cast.append((log_odds, ellipses, circles))
    _, ellipses, circles = max(
        cast, key=lambda coin: coin[0] + sum(circle.log_odds for circle in coin[2])
    )
    if sum(circle.log_odds for circle in circles) < LEAST_ROUND:
        return Failure(
            "marker_not_found",
            "No coin lies flat on the table.",
            "Lay the coin flat on the table beside the plate.",
        )
    scale = known.diameter_mm / 2 / float(np.sqrt(circles[0].radius_mm * circles[1].radius_mm))
    middle_mm = scale * (circles[0].middle_mm + circles[1].middle_mm) / 2
    middle_mm -= [0.0, 0.0, known.thick_mm]
    sd = float(np.linalg.norm([size_sd(ellipse) for ellipse in ellipses])) / 2

    def moved(pair: tuple[View, View], factor: float) -> tuple[View, View]:
        first, second = (
            replace(
                view,
                translation_mm=factor * view.translation_mm + view.rotation @ middle_mm,
                known=known,
            )
            for view in pair
        )
        return first, second

    first, second = moved(views, scale)
    doubts = [moved(pair, scale) for pair in refined.doubts]
    doubts.append(moved(views, scale * (1 + sd)))
    longer = 1 + focal_sd(first.camera)
    if longer > 1:
        doubts.append((zoomed(first, longer), zoomed(second, longer)))
    return replace(refined, first=first, second=second, doubts=tuple(doubts))


@dataclass(frozen=True, slots=True)
class _Circle:
    """What an ellipse is on a level. middle_mm: (3,). log_odds: that it is a circle."""

    middle_mm: Float64Array
    radius_mm: float
    log_odds: float


def _on_level(view: View, ellipse: Ellipse, level_mm: float) -> _Circle:
    """Return an ellipse cast onto a level over the table."""
    rays = homogeneous(undistort_to_rays(view, ellipse.points())) @ view.rotation
    centre = view.centre_mm
    cast = centre + rays * ((level_mm - centre[2]) / rays[:, 2])[:, None]
    middle = np.asarray(cast.mean(axis=0), np.float64)
    _, half, _ = np.linalg.svd(cast[:, :2] - middle[:2], full_matrices=False)
    flattened = float(np.log(half[0] / half[1]))
    radius_mm = float(np.linalg.norm(cast - middle, axis=1).mean())
    return _Circle(middle, radius_mm, -float(np.log1p((flattened / FLATTENED_SD) ** 2)))
