"""SIFT matches between the two views (paper, section IV.A), told apart by where they lie: checkerboard, food, support.

Two Views in -> matched points in each photograph, px. Which matches are good is for epipolar.py to say.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import Failure
from app.vision.model import Float32Array, Float64Array, ImageArray, MarkerSpec, View

MATCHING_SIDE_PX = 1200  # long side of the reduced photographs; SIFT's own scale space makes more pointless
MAX_FEATURES = 3000
MIN_CONTRAST = 0.01  # a quarter of SIFT's default: food and plates are pale and smooth
MAX_RATIO = 0.75  # of the best to the second best distance (Lowe, 2004, section 7.1)
FOOD_MIN_HEIGHT_MM = 8.0  # over the marker's plane; what lies lower may be table, sheet or plate
FOOD_MAX_HEIGHT_MM = 250.0  # beyond, a triangulated match is a wrong one
SHEET_MARGIN_SQUARES = 1.0  # white paper around the squares (CONVENTIONS.md, "Marker")
MIN_MATCHES = 8  # what the 8-point method needs (paper, section IV.A)


@dataclass(frozen=True, slots=True)
class Matches:
    """Matched points of the first and the second view, px of the photographs (distorted), and their regions.

    first_px, second_px: (n, 2). is_board, is_food: (n,) bool; neither: support or background.
    """

    first_px: Float64Array
    second_px: Float64Array
    is_board: NDArray[np.bool_]
    is_food: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of matches."""
        return len(self.first_px)


def match_features(first: View, second: View) -> Matches | Failure:
    """Mutual SIFT matches that pass the ratio test, together with the marker's own corners, which match by name.

    SIFT alone can hardly match a checkerboard, all of whose corners look alike. Failure "too_few_matches".
    """
    found = [_detect(view.photo.pixels_bgr) for view in (first, second)]
    (first_px, first_descriptors), (second_px, second_descriptors) = found
    pairs = _mutual_matches(first_descriptors, second_descriptors)
    first_px, second_px = first_px[pairs[:, 0]], second_px[pairs[:, 1]]
    points = triangulate(first, second, first_px, second_px)
    on_sheet = is_on_sheet(first.marker.spec, points)
    with np.errstate(invalid="ignore"):
        is_food = (points[:, 2] > FOOD_MIN_HEIGHT_MM) & (points[:, 2] < FOOD_MAX_HEIGHT_MM) & ~on_sheet
    corners = np.ones(len(first.marker.corners_px), np.bool_)
    keep = ~on_sheet  # the sheet's SIFT matches are the ambiguous ones; its corners stand for it
    matches = Matches(
        np.concatenate([first.marker.corners_px, first_px[keep]]),
        np.concatenate([second.marker.corners_px, second_px[keep]]),
        np.concatenate([corners, np.zeros(int(keep.sum()), np.bool_)]),
        np.concatenate([~corners, is_food[keep]]),
    )
    if int((~matches.is_board).sum()) < MIN_MATCHES:
        return too_few_matches(int((~matches.is_board).sum()))
    return matches


def too_few_matches(count: int) -> Failure:
    """The failure where the two photographs share too little."""
    return Failure(
        "too_few_matches",
        f"Only {count} points of the meal could be found again in the other photograph, {MIN_MATCHES} are needed.",
        "Take both photographs from the same side of the table, about a hand's width apart, sharp and well lit.",
    )


def triangulate(first: View, second: View, first_px: Float64Array, second_px: Float64Array) -> Float64Array:
    """(n, 3) points in the table frame, mm, from (n, 2) px in each photograph; linear, NaN at infinity."""
    if len(first_px) == 0:
        return np.empty((0, 3))
    rays = [undistort_to_rays(view, pixels) for view, pixels in ((first, first_px), (second, second_px))]
    projections = [np.column_stack([view.rotation, view.translation_mm]) for view in (first, second)]
    homogeneous = cv2.triangulatePoints(projections[0], projections[1], rays[0].T, rays[1].T)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = (homogeneous[:3] / homogeneous[3]).T
    points[~np.isfinite(points).all(axis=1)] = np.nan
    return np.asarray(points, np.float64)


def undistort_to_rays(view: View, pixels: Float64Array) -> Float64Array:
    """(n, 2) px of the photograph -> (n, 2) x / z, y / z in the camera's frame."""
    if len(pixels) == 0:
        return np.empty((0, 2))
    camera = view.camera
    ideal = cv2.undistortPoints(
        np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2), camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(ideal, np.float64).reshape(-1, 2)


def undistort_to_pinhole(view: View, pixels: Float64Array) -> Float64Array:
    """(n, 2) px of the photograph -> (n, 2) px of the pinhole with the same K, where eq. 1-8 hold."""
    camera = view.camera
    return undistort_to_rays(view, pixels) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def is_on_sheet(spec: MarkerSpec, points_table: Float64Array | Float32Array) -> NDArray[np.bool_]:
    """(...,) whether (..., 3) points lie over the printed sheet, margin included; False for NaN."""
    half_x = (spec.columns / 2 + SHEET_MARGIN_SQUARES) * spec.square_mm
    half_y = (spec.rows / 2 + SHEET_MARGIN_SQUARES) * spec.square_mm
    with np.errstate(invalid="ignore"):
        is_inside = (np.abs(points_table[..., 0]) <= half_x) & (np.abs(points_table[..., 1]) <= half_y)
    return np.asarray(is_inside, np.bool_)


def _detect(pixels_bgr: ImageArray) -> tuple[Float64Array, NDArray[np.float32]]:
    """Keypoints (n, 2) in px of the full photograph and their descriptors (n, 128)."""
    grey = cv2.cvtColor(pixels_bgr, cv2.COLOR_BGR2GRAY)
    height, width = grey.shape
    scale = min(1.0, MATCHING_SIDE_PX / max(height, width))
    small = cv2.resize(grey, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
    keypoints, descriptors = cv2.SIFT.create(MAX_FEATURES, contrastThreshold=MIN_CONTRAST).detectAndCompute(small, None)
    if len(keypoints) == 0:  # descriptors are None then
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    points = np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2)
    ratio = np.array([width / small.shape[1], height / small.shape[0]])
    return (points + 0.5) * ratio - 0.5, np.asarray(descriptors, np.float32)


def _mutual_matches(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.int64]:
    """(n, 2) indices of descriptors that are each other's nearest, clearly nearer than the second nearest."""
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.int64)
    similarity = first @ second.T  # SIFT vectors are of equal length, up to rounding: largest product, least distance
    squared = (first**2).sum(1)[:, None] + (second**2).sum(1)[None, :] - 2.0 * similarity
    nearest = np.argpartition(squared, 1, axis=1)[:, :2]
    distances = np.take_along_axis(squared, nearest, axis=1)
    order = np.argsort(distances, axis=1)
    nearest, distances = np.take_along_axis(nearest, order, axis=1), np.take_along_axis(distances, order, axis=1)
    rows = np.arange(len(first))
    is_mutual = squared.argmin(axis=0)[nearest[:, 0]] == rows
    is_clear = distances[:, 0] < MAX_RATIO**2 * distances[:, 1]
    good = is_mutual & is_clear
    return np.column_stack([rows[good], nearest[good, 0]])
