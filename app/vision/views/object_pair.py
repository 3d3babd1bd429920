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

from app.vision.board.round_object import MaybeCoin
from app.vision.geometry.ellipse import Ellipse
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.model import Float64Array, PhotoPair, View
from app.vision.rig import MAX_BASELINE_MM, MIN_BASELINE_MM, StereoRig
from app.vision.views.features import (
    MATCHING_SIDE_PX,
    UNPLACED_FINER,
    match_unplaced,
    triangulate,
    undistort_to_rays,
)
from app.vision.views.object_view import FOCAL_SDS, place_by_object, size_sd, zoomed
from app.vision.views.relative_pose import RefinedViews

ON_LINE_PX = 1.0  # from an epipolar line, where features are looked for
CONFIDENCE = 0.9999
MIN_INLIERS = 20
MOST_COINS = 8  # in both photographs that may be it
# log of the half-axes' ratio of a coin on a table that is tilted by some degrees
FLATTENED_SD = 0.06
LEAST_ROUND = -4.5  # of both: less round, and the table or the poses are wrong
OFF_SD = 0.2  # of a coin's radius, between where two ellipses put its middle
SIZE_RATIO_SD = 0.08  # between the distances that they tell


@dataclass(frozen=True, slots=True)
class CoinInBoth:
    """Two ellipses that may be the coin. log_odds: that they are. baseline_mm: by what they tell of their distance."""

    ellipses: tuple[Ellipse, Ellipse]
    log_odds: float
    baseline_mm: float


@dataclass(frozen=True, slots=True)
class ObjectRig:
    """The rig that two photographs make. coins: what may be the coin in both, the likeliest first. matches: count."""

    rig: StereoRig
    coins: tuple[CoinInBoth, ...]
    matches: int


def rig_of_object(
    pair: PhotoPair,
    cameras: tuple[Camera, Camera],
    candidates: tuple[Sequence[MaybeCoin], Sequence[MaybeCoin]],
    known: KnownObject,
) -> ObjectRig | None:
    """Return the rig by the likeliest ellipses that are one thing in both photographs; None if there are none.

    candidates: of the coin, in the left and the right photograph. None also for too few matches.
    """
    views = [
        View(photo, camera, None, np.eye(3), np.zeros(3), 0.0)
        for photo, camera in zip(pair.both, cameras, strict=True)
    ]
    left_px, right_px = match_unplaced(pair.both)
    if len(left_px) < MIN_INLIERS:
        return None
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
        return None
    count, rotation, shift, _ = cv2.recoverPose(essential, left_rays, right_rays, np.eye(3))
    if count < MIN_INLIERS:
        return None
    turn, step = np.asarray(rotation, np.float64), np.asarray(shift, np.float64).ravel()
    judged = [
        _in_both(views, (left, right), turn, step, known.diameter_mm / 2)
        for left, right in product(*candidates)
    ]
    coins = [coin for coin in judged if coin is not None]
    if not coins:
        return None
    coins.sort(key=lambda coin: -coin.log_odds)
    alone = place_by_object(pair.left, cameras[0], coins[0].ellipses[0], known).first
    rows = [(float(x), float(y), float(z)) for x, y, z in turn]
    step_x, step_y, step_z = (coins[0].baseline_mm * step).tolist()
    up_x, up_y, up_z = alone.rotation[:, 2].tolist()
    rig = StereoRig(
        *cameras,
        rotation=(rows[0], rows[1], rows[2]),
        translation_mm=(step_x, step_y, step_z),
        source="object",
        up=(up_x, up_y, up_z),
    )
    return ObjectRig(rig, tuple(coins[:MOST_COINS]), int(count))


def _in_both(
    views: Sequence[View],
    coins: Sequence[MaybeCoin],
    rotation: Float64Array,
    step: Float64Array,
    radius_mm: float,
) -> CoinInBoth | None:
    """Return what two ellipses are as one coin; None if they are apart. rotation, step: of the relative pose.

    A circle's larger half-axis tells its distance, whatever its tilt.
    """
    ellipses = coins[0].ellipse, coins[1].ellipse
    rays = [
        undistort_to_rays(view, ellipse.centre[None])
        for view, ellipse in zip(views, ellipses, strict=True)
    ]
    place = cv2.triangulatePoints(
        np.eye(3, 4), np.column_stack([rotation, step]), rays[0].T, rays[1].T
    ).ravel()
    first = place[:3] / place[3]
    second = rotation @ first + step
    if not (first[2] > 0 and second[2] > 0):
        return None
    log_odds = sum(coin.log_odds for coin in coins)
    log_baselines = []
    for view, ellipse, ray, point in zip(views, ellipses, rays, (first, second), strict=True):
        off_px = float(np.linalg.norm(point[:2] / point[2] - ray)) * view.camera.fx
        log_odds -= 0.5 * (off_px / ellipse.radius / OFF_SD) ** 2
        distance_mm = view.camera.fx * radius_mm / float(ellipse.half.max())
        log_baselines.append(float(np.log(distance_mm / point[2])))
    log_odds -= 0.5 * ((log_baselines[0] - log_baselines[1]) / SIZE_RATIO_SD) ** 2
    baseline_mm = float(np.exp(np.mean(log_baselines)))
    if not MIN_BASELINE_MM < baseline_mm < MAX_BASELINE_MM:
        return None
    return CoinInBoth(ellipses, log_odds, baseline_mm)


def in_scale(
    refined: RefinedViews,
    coins: Sequence[CoinInBoth],
    known: KnownObject,
    *,
    is_swapped: bool,
) -> RefinedViews | None:
    """Return views over the table in the coin's scale, the table frame's origin under its middle.

    What lies flat on the table is a circle there, in both views; None if nothing is.
    is_swapped: whether the first view is the right photograph's.
    """
    views = refined.first, refined.second
    cast = []
    for coin in coins:
        ellipses = coin.ellipses[::-1] if is_swapped else coin.ellipses
        level_mm = float(triangulate(*views, *(each.centre[None] for each in ellipses))[0, 2])
        circles = [
            _on_level(view, ellipse, level_mm)
            for view, ellipse in zip(views, ellipses, strict=True)
        ]
        log_round = sum(circle.log_odds for circle in circles)
        cast.append((coin.log_odds + log_round, log_round, ellipses, circles))
    _, log_round, ellipses, circles = max(cast, key=lambda coin: coin[0])
    if log_round < LEAST_ROUND:
        return None
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
    longer = 1 + FOCAL_SDS[first.camera.source]
    if longer > 1:
        doubts.append((zoomed(first, longer), zoomed(second, longer)))
    return replace(refined, first=first, second=second, doubts=tuple(doubts))


@dataclass(frozen=True, slots=True)
class _Circle:
    """An ellipse cast onto a level. middle_mm: (3,). log_odds: that it is a circle."""

    middle_mm: Float64Array
    radius_mm: float
    log_odds: float


def _on_level(view: View, ellipse: Ellipse, level_mm: float) -> _Circle:
    """Return an ellipse cast onto a level over the table."""
    rays = homogeneous(undistort_to_rays(view, ellipse.points())) @ view.rotation
    centre = view.centre_mm
    cast = centre + rays * ((level_mm - centre[2]) / rays[:, 2])[:, None]
    middle = cast.mean(axis=0)
    _, half, _ = np.linalg.svd(cast[:, :2] - middle[:2], full_matrices=False)
    flattened = float(np.log(half[0] / half[1]))
    radius_mm = float(np.linalg.norm(cast - middle, axis=1).mean())
    return _Circle(middle, radius_mm, -float(np.log1p((flattened / FLATTENED_SD) ** 2)))
