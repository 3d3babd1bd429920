"""Matches between the two views: SIFT (paper, section IV.A) and corners, told apart as checkerboard, food, support.

Two Views in -> matched points in each photograph, px. Which matches are good is for epipolar.py to say.
"""

import itertools
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from app.core.errors import Failure
from app.vision.board.print_layout import common_points, seen_print_mm
from app.vision.geometry.pictures import grey_of, reduce_by
from app.vision.geometry.projective import cross_matrix, homogeneous, map_points
from app.vision.marker_spec import TagBoard
from app.vision.model import (
    Float32Array,
    Float64Array,
    ImageArray,
    MarkerObservation,
    Photo,
    View,
)
from app.vision.views.point_following import corners_of, evenly_lit, follow_points

# long side where SIFT runs: which point is which; where it is, Lucas and Kanade tell
MATCHING_SIDE_PX = 512
ALIGNED_SIDE_PX = 1600  # about the long side where matches are aligned: phones resolve little more
MAX_FEATURES = 500
UNPLACED_FINER = 2  # where no pose helps, and the pose has to come of it
# SIFT's default is 0.04: food and plates are pale and smooth. The second where the first finds few features.
MIN_CONTRASTS = (0.01, 0.003)
FEW_FEATURES = 150
MAX_RATIO = 0.8  # of the best to the second best distance (Lowe, 2004, section 7.1)
# of the long side, from the epipolar line: what poses by the marker alone may be off by
GATE_SHARE = 0.006
FOOD_MIN_HEIGHT_MM = 8.0  # over the marker's plane; what lies lower may be table, sheet or plate
FOOD_MAX_HEIGHT_MM = 250.0  # beyond, a triangulated match is a wrong one
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

    @property
    def beside_board(self) -> int:
        """Number of matches that are not the marker's."""
        return int(np.count_nonzero(~self.is_board))

    @property
    def are_few(self) -> bool:
        """Return whether too few lie beside the marker to tell anything: a plain table, or two different scenes."""
        return self.beside_board < MIN_MATCHES


def match_features(first: View, second: View, gate_share: float = GATE_SHARE) -> Matches:
    """Points followed from one view to the other, with the marker's own corners, which match by name.

    gate_share: see GATE_SHARE. A checkerboard's corners all look alike. Without a marker there are the others alone.
    """
    first_px, second_px = _matches_beside(first, second, gate_share)
    points = triangulate(first, second, first_px, second_px)
    on_sheet = (
        is_on_sheet(first.marker, points)
        if first.marker is not None
        else np.zeros(len(points), np.bool_)
    )
    is_food = (points[:, 2] > FOOD_MIN_HEIGHT_MM) & (points[:, 2] < FOOD_MAX_HEIGHT_MM) & ~on_sheet
    corners_px, corners_second_px = _shared_corners(first, second)
    corners = np.ones(len(corners_px), np.bool_)
    keep = ~on_sheet  # where matches are ambiguous; its corners stand for it
    return Matches(
        np.concatenate([corners_px, first_px[keep]]),
        np.concatenate([corners_second_px, second_px[keep]]),
        np.concatenate([corners, np.zeros(int(keep.sum()), np.bool_)]),
        np.concatenate([~corners, is_food[keep]]),
    )


def match_unplaced(photos: tuple[Photo, Photo]) -> tuple[Float64Array, Float64Array]:
    """Mutual SIFT matches (n, 2), (n, 2), px, of photographs whose poses are not known; not aligned."""
    reduced = [_reduced_grey(photo.pixels_bgr) for photo in photos]
    (at, first), (at_second, second) = (
        _detect(grey, np.full_like(grey, 255), finer=UNPLACED_FINER) for grey, _ in reduced
    )
    pairs = _mutual_matches(first, second, np.ones((len(at), len(at_second)), np.bool_))
    return (
        _at_full_size(at[pairs[:, 0]], reduced[0][1]),
        _at_full_size(at_second[pairs[:, 1]], reduced[1][1]),
    )


def _shared_corners(first: View, second: View) -> tuple[Float64Array, Float64Array]:
    """(n, 2), (n, 2) px of the marker's points that both views have; none without a marker."""
    if first.marker is None or second.marker is None:
        return np.empty((0, 2)), np.empty((0, 2))
    common = common_points(first.marker, second.marker)
    return common.first_px, common.second_px


def too_few_matches(count: int) -> Failure:
    """The failure where the two photographs share too little."""
    return Failure(
        "too_few_matches",
        f"Only {count} points of the meal could be found again in the other photograph, too few to measure it.",
        "Take both photographs from the same side of the table, about a hand's width apart, sharp and well lit.",
    )


def triangulate(
    first: View, second: View, first_px: Float64Array, second_px: Float64Array
) -> Float64Array:
    """(n, 3) points in the table frame, mm, from (n, 2) px in each photograph; linear, NaN at infinity."""
    if len(first_px) == 0:
        return np.empty((0, 3))
    rays = [
        undistort_to_rays(view, pixels) for view, pixels in ((first, first_px), (second, second_px))
    ]
    projections = [
        np.column_stack([view.rotation, view.translation_mm]) for view in (first, second)
    ]
    solved = cv2.triangulatePoints(projections[0], projections[1], rays[0].T, rays[1].T)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = (solved[:3] / solved[3]).T
    points[~np.isfinite(points).all(axis=1)] = np.nan
    return np.asarray(points, np.float64)


def undistort_to_rays(view: View, pixels: Float64Array) -> Float64Array:
    """(n, 2) px of the photograph -> (n, 2) x / z, y / z in the camera's frame."""
    if len(pixels) == 0:
        return np.empty((0, 2))
    camera = view.camera
    ideal = cv2.undistortPoints(
        np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2),
        camera.matrix,
        np.array(camera.distortion),
    )
    return np.asarray(ideal, np.float64).reshape(-1, 2)


def undistort_to_pinhole(view: View, pixels: Float64Array) -> Float64Array:
    """(n, 2) px of the photograph -> (n, 2) px of the pinhole with the same K, where eq. 1-8 hold."""
    camera = view.camera
    return undistort_to_rays(view, pixels) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def is_on_sheet(
    marker: MarkerObservation, points_table: Float64Array | Float32Array
) -> NDArray[np.bool_]:
    """(...,) whether (..., 3) points lie over what is seen of the print, margin included; False for NaN."""
    x, y = points_table[..., 0], points_table[..., 1]
    is_on = np.zeros(x.shape, np.bool_)
    for low_x, low_y, high_x, high_y in seen_print_mm(marker):
        is_on |= (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
    return is_on


def shows_sheet(
    marker: MarkerObservation, plane_mm: Float32Array, centre_mm: Float64Array
) -> NDArray[np.bool_]:
    """(...,) whether a line of sight meets what is seen of the print or, where it is raised, its sides; False for NaN.

    plane_mm: (..., 3) where each line of sight meets the table, z = 0. centre_mm: (3,) the camera's. The way from
    z = thick_mm down to the table is a segment over the table; it crosses a rectangle of the print (slab method).
    """
    # of the way from the table to the camera
    rise = np.float32(marker.spec.thick_mm / centre_mm[2])
    is_shown = np.zeros(plane_mm.shape[:-1], np.bool_)
    for low_x, low_y, high_x, high_y in seen_print_mm(marker):
        enter, leave = (
            np.zeros(plane_mm.shape[:-1], np.float32),
            np.ones(plane_mm.shape[:-1], np.float32),
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            for axis, (low, high) in enumerate(((low_x, high_x), (low_y, high_y))):
                low_end = plane_mm[..., axis]
                along = (np.float32(centre_mm[axis]) - low_end) * rise
                along = np.where(np.abs(along) < 1e-6, np.float32(1e-6), along)
                bounds = (np.float32(low) - low_end) / along, (np.float32(high) - low_end) / along
                enter = np.maximum(enter, np.minimum(*bounds))
                leave = np.minimum(leave, np.maximum(*bounds))
            is_shown |= enter <= leave
    return is_shown


def _matches_beside(
    first: View, second: View, gate_share: float
) -> tuple[Float64Array, Float64Array]:
    """(n, 2), (n, 2) px of the photographs: beside the sheet and near their epipolar lines.

    The second view is first brought onto the first one by the marker's plane, which takes roll, zoom and most of the
    slant away: what lies near the plane is followed from where it is in the first view, what SIFT matches from there.
    """
    (grey, factor), (grey_second, factor_second) = (
        _reduced_grey(view.photo.pixels_bgr) for view in (first, second)
    )
    to_second = (
        _reduction(factor_second)
        @ _plane_homography(first, second)
        @ np.linalg.inv(_reduction(factor))
    )
    size = (grey.shape[1], grey.shape[0])
    turned = cv2.warpPerspective(
        grey_second, to_second, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    mask = _beside_sheet(first, factor, size)
    has_tags = first.marker is not None and isinstance(first.marker.spec, TagBoard)
    detect = partial(_detect, mask=mask, has_tags=has_tags)
    features = [detect(picture) for picture in (grey, np.asarray(turned, np.uint8))]
    at, at_turned = features[0][0], features[1][0]
    first_px = _at_full_size(at, factor)
    second_px = _at_full_size(map_points(to_second, at_turned), factor_second)
    is_near = _is_near_line(first, second, first_px, second_px, gate_share)
    pairs = _mutual_matches(features[0][1], features[1][1], is_near)
    pictures = [evenly_lit(picture) for picture in (grey, np.asarray(turned, np.uint8))]
    corners = corners_of(pictures[0], mask)
    at = np.concatenate([at[pairs[:, 0]], corners])
    start = np.concatenate([at_turned[pairs[:, 1]], corners])
    at, at_turned = follow_points(pictures[0], pictures[1], at, start)
    first_px = _at_full_size(at, factor)
    second_px = _at_full_size(map_points(to_second, at_turned), factor_second)
    is_near = np.diagonal(_is_near_line(first, second, first_px, second_px, gate_share))
    return first_px[is_near], second_px[is_near]


def _reduced_grey(pixels_bgr: ImageArray) -> tuple[ImageArray, int]:
    """Grey at about ALIGNED_SIDE_PX, and by which whole factor it was reduced."""
    factor = max(1, round(max(pixels_bgr.shape) / ALIGNED_SIDE_PX))
    return reduce_by(grey_of(pixels_bgr), factor), factor


def _reduction(factor: int) -> Float64Array:
    """(3, 3) from px of the photograph to px of it reduced."""
    shift = (1.0 - factor) / (2.0 * factor)
    return np.array([[1.0 / factor, 0.0, shift], [0.0, 1.0 / factor, shift], [0.0, 0.0, 1.0]])


def _at_full_size(points: Float64Array, factor: int) -> Float64Array:
    return (points + 0.5) * factor - 0.5


def _plane_homography(first: View, second: View) -> Float64Array:
    """(3, 3) from the first view's px to the second's, of points on the marker's plane; distortion left out."""
    to_first, to_second = (
        view.camera.matrix @ np.column_stack([view.rotation[:, :2], view.translation_mm])
        for view in (first, second)
    )
    return to_second @ np.linalg.inv(to_first)


def _beside_sheet(view: View, factor: int, size: tuple[int, int]) -> ImageArray:
    """(H, W) 255 but on what is seen of the print and its sides, in the reduced view. size: (width, height)."""
    camera = view.camera
    mask = np.full((size[1], size[0]), 255, np.uint8)
    if view.marker is None:
        return mask
    for low_x, low_y, high_x, high_y in seen_print_mm(view.marker):
        sides = (low_x, high_x), (low_y, high_y), (0.0, view.marker.spec.thick_mm)
        seen = np.array(list(itertools.product(*sides))) @ view.rotation.T + view.translation_mm
        outline = seen[:, :2] / np.maximum(seen[:, 2:], 1e-3) * [camera.fx, camera.fy] + [
            camera.cx,
            camera.cy,
        ]
        hull = cv2.convexHull(np.rint((outline + 0.5) / factor - 0.5).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 0)
    return mask


def _detect(
    grey: ImageArray, mask: ImageArray, *, has_tags: bool = False, finer: int = 1
) -> tuple[Float64Array, NDArray[np.float32]]:
    """Keypoints (n, 2) in px of grey and their descriptors (n, 128), found at MATCHING_SIDE_PX where mask is not 0.

    finer: by which factor, with its square of keypoints. has_tags: the picture shows a board of tags. OpenCV keeps the
    strongest keypoints before it looks at the mask, and a sheet of tags has more of them than all of the meal.
    """
    height, width = grey.shape
    scale = min(1.0, finer * MATCHING_SIDE_PX / max(height, width))
    size = (round(width * scale), round(height * scale))
    small, small_mask = cv2.resize(grey, size, interpolation=cv2.INTER_AREA), cv2.resize(mask, size)
    for contrast in MIN_CONTRASTS:
        sift = cv2.SIFT.create(
            0 if has_tags else finer**2 * MAX_FEATURES, contrastThreshold=contrast
        )
        if has_tags:
            strongest = sorted(sift.detect(small, small_mask), key=lambda point: -point.response)[
                :MAX_FEATURES
            ]
            keypoints, descriptors = sift.compute(small, strongest)
        else:
            keypoints, descriptors = sift.detectAndCompute(small, small_mask)
        if len(keypoints) >= FEW_FEATURES:
            break
    if len(keypoints) == 0:  # descriptors are None then
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    points = np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2)
    ratio = np.array([width / size[0], height / size[1]])
    return (points + 0.5) * ratio - 0.5, np.asarray(descriptors, np.float32)


def _is_near_line(
    first: View, second: View, first_px: Float64Array, second_px: Float64Array, gate_share: float
) -> NDArray[np.bool_]:
    """(n, m) whether second_px (m, 2) lie near the epipolar lines of first_px (n, 2), by the views."""
    if len(first_px) == 0 or len(second_px) == 0:
        return np.empty((len(first_px), len(second_px)), np.bool_)
    rays, rays_second = undistort_to_rays(first, first_px), undistort_to_rays(second, second_px)
    turn = second.rotation @ first.rotation.T
    essential = cross_matrix(second.translation_mm - turn @ first.translation_mm) @ turn
    lines = homogeneous(rays) @ essential.T
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    distance = (lines @ homogeneous(rays_second).T).astype(np.float32)
    limit = gate_share * max(second.camera.width, second.camera.height) / second.camera.fx
    return np.abs(distance) < limit


def _mutual_matches(
    first: NDArray[np.float32], second: NDArray[np.float32], is_allowed: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """(k, 2) indices of descriptors that are each other's nearest of those allowed, clearly nearer than the next.

    is_allowed: (n, m).
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.int64)
    # |a - b|^2 in two steps; SIFT vectors are of equal length only up to rounding.
    squared = (first**2).sum(1)[:, None] + (second**2).sum(1)[None, :] - 2.0 * (first @ second.T)
    squared[~is_allowed] = np.inf
    rows = np.arange(len(first))
    nearest = squared.argmin(axis=1)
    distance = squared[rows, nearest]
    is_mutual = squared.argmin(axis=0)[nearest] == rows
    squared[rows, nearest] = np.inf
    good = is_mutual & np.isfinite(distance) & (distance < MAX_RATIO**2 * squared.min(axis=1))
    return np.column_stack([rows[good], nearest[good]])
