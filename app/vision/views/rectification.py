"""The rectification that depth is measured on, from the poses; the paper's, from F, is paper/fundamental.py's.

Views in -> a row-aligned pair at working resolution with its geometry. Why there are two:
docs/decisions/0001-rectification-by-f-and-by-poses.md.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.pictures import reduce_by
from app.vision.geometry.projective import homogeneous, rotation_along
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray, View
from app.vision.views.features import undistort_to_rays

# long side of the rectified pair: a food of 50 mm at 500 mm spans some 120 px
WORKING_SIDE_PX = 1280
# over the marker's plane: what the disparity search covers
MIN_HEIGHT_MM, MAX_HEIGHT_MM = -15.0, 200.0
MAP_STEP_PX = 8  # between computed points of the maps: the error of interpolation stays below a hundredth of a pixel
ALIASING_FREE = 0.9  # of the reduction from photograph to grid: what is left, linear sampling bears
INVERSE_DEPTH_BASELINE_MM = 10.0  # of a single view: its unit of inverse depth, f B px mm
MAX_SHARE_OF_CAMERA_HEIGHT = 0.7  # nothing is searched for nearer to the lens than that
TALL_MM, TALL_SHARE = 100.0, 0.5  # of the tallest foods, at most that share of the camera's height


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """Both views on one grid: rows are epipolar lines, and the marker's plane has parallax zero.

    A single view has its own grid: second_bgr is None, and baseline_mm, INVERSE_DEPTH_BASELINE_MM, makes of a depth
    that was measured otherwise a parallax, so that inverse depths are px here as they are there.

    first_bgr, second_bgr: (H, W, 3); black where a view does not reach. is_seen: (H, W) both views reach it (at the
    marker's plane). first_map_px: (H, W, 2) each pixel's place in the first photograph. focal_px, centre_px: of the
    rectified first camera. rotation: (3, 3) table to rectified camera. first_centre_mm: (3,) table frame.
    baseline_mm: along the rows. plane_px: (a, b, c), the marker plane's disparity a x + b y + c.
    parallax_range_px: what the search has to cover.
    """

    first_bgr: ImageArray
    second_bgr: ImageArray | None
    is_seen: MaskArray
    first_map_px: Float32Array
    focal_px: float
    centre_px: tuple[float, float]
    rotation: Float64Array
    first_centre_mm: Float64Array
    baseline_mm: float
    plane_px: tuple[float, float, float]
    parallax_range_px: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.first_bgr.shape[0], self.first_bgr.shape[1]

    @property
    def both_bgr(self) -> tuple[ImageArray, ImageArray]:
        """First and second picture. Raises ValueError for a single view."""
        if self.second_bgr is None:
            raise ValueError("A single view has no second picture.")
        return self.first_bgr, self.second_bgr

    @property
    def pixel_mm(self) -> float:
        """What a pixel spans on the marker's plane in the middle of what is seen, across the line of sight, mm."""
        disparity = self.plane_disparity_px()[self.is_seen]
        middle = float(np.median(disparity)) if disparity.size else self.plane_px[2]
        return self.baseline_mm / max(middle, 1e-6)  # depth over focal length, f B / d / f

    def plane_disparity_px(self) -> Float32Array:
        """(H, W) disparity of the marker's plane."""
        height, width = self.shape
        a, b, c = self.plane_px
        return (a * np.arange(width)).astype(np.float32) + (b * np.arange(height) + c).astype(
            np.float32
        )[:, None]

    def disparity_from_parallax(self, parallax_px: Float32Array) -> Float32Array:
        """(H, W) disparity x_first - x_second of the row-aligned pair, px, from parallax against the marker's plane.

        The second image is sheared by x_s (1 - a) = x_second + b y + c, so a parallax x - x_s counts 1 - a times.
        """
        return self.plane_disparity_px() + np.float32(1.0 - self.plane_px[0]) * parallax_px

    def parallax_from_disparity(self, disparity_px: Float32Array) -> Float32Array:
        """(H, W) px: the inverse of disparity_from_parallax."""
        return (disparity_px - self.plane_disparity_px()) / np.float32(1.0 - self.plane_px[0])

    def rays(self, pixels: Float64Array) -> Float64Array:
        """(n, 2) px on the grid -> (n, 3) x / z, y / z, 1 in the rectified first camera's frame."""
        return homogeneous((pixels - self.centre_px) / self.focal_px)

    def project(self, points_table: Float64Array) -> Float64Array:
        """(n, 3) mm -> (n, 3): x, y on the grid, px, and depth Z, mm."""
        points = (points_table - self.first_centre_mm) @ self.rotation.T
        pixels = self.focal_px * points[:, :2] / points[:, 2:] + self.centre_px
        return np.column_stack([pixels, points[:, 2]])


def to_rectified_px(pair: RectifiedPair, view: View, pixels: Float64Array) -> Float64Array:
    """(n, 2) px of a photograph -> (n, 2) px of the row-aligned pair, before the second image is sheared."""
    rays = undistort_to_rays(view, pixels)
    turned = homogeneous(rays) @ view.rotation @ pair.rotation.T
    return pair.focal_px * turned[:, :2] / turned[:, 2:] + pair.centre_px


def is_swapped(left: View, right: View) -> bool:
    """Return whether the view named left stands on the right, so that its grid would be upside down.

    Of a pair one above the other, the grid lies on its side either way, and the view named left is the first.
    """
    baseline = (left.rotation + right.rotation) @ (right.centre_mm - left.centre_mm)
    return bool(-baseline[0] >= abs(baseline[1]))


def rectify_by_poses(first: View, second: View) -> RectifiedPair:
    """Turn both cameras about their centres until their rows lie along the baseline (Fusiello et al., 2000).

    The second image is further sheared by the marker plane's disparity, so that windows on the support match without
    slant and the search begins at zero.
    """
    baseline = second.centre_mm - first.centre_mm
    baseline_mm = float(np.linalg.norm(baseline))
    # near both optical axes
    rotation = rotation_along(baseline, first.rotation[2] + second.rotation[2])
    # Along a ray (u, v, 1) the marker's plane lies at inverse depth plane . (u, v, 1): z = 0 in the table frame.
    plane = -rotation[:, 2] / first.centre_mm[2]
    low, high = _seen_bounds(first, second, rotation, plane, baseline_mm)
    focal_first = float(np.sqrt(first.camera.fx * first.camera.fy))
    focal = min(focal_first, WORKING_SIDE_PX / float((high - low).max()))
    # Of a wide pair, one view may miss the table behind a food that both of them show.
    lift = _lift(first, second)
    low_tall, high_tall = _seen_bounds(first, second, rotation, plane, baseline_mm, lift)
    # the rest stays as it is
    before = np.ceil(np.maximum(low - low_tall, 0.0) * focal / MAP_STEP_PX) * MAP_STEP_PX
    low, high = low - before / focal, np.maximum(high, high_tall)
    width, height = (int(np.ceil(side * focal)) for side in high - low)
    centre_x, centre_y = -low * focal
    matrix = np.array([[focal, 0.0, centre_x], [0.0, focal, centre_y], [0.0, 0.0, 1.0]])
    a, b = plane[:2] * baseline_mm
    c = focal * baseline_mm * plane[2] - a * centre_x - b * centre_y
    shear = np.array([[1.0, b, c], [0.0, 1.0 - a, 0.0], [0.0, 0.0, 1.0 - a]]) / (1.0 - a)
    first_bgr, first_map = warp_view(first, matrix, rotation, (width, height))
    second_bgr, second_map = warp_view(second, shear @ matrix, rotation, (width, height))
    disparity = a * np.arange(width)[None, :] + b * np.arange(height)[:, None] + c
    in_second = _is_inside(second, second_map)
    in_both = (disparity > 0) & _is_inside(first, first_map) & in_second
    tall_px = np.arange(width) - (lift / (1.0 - a) * disparity).astype(np.float32)
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], tall_px.shape)
    is_tall_seen = (
        cv2.remap(
            in_second.astype(np.uint8),
            tall_px.astype(np.float32),
            np.ascontiguousarray(rows),
            cv2.INTER_NEAREST,
        )
        > 0
    )
    is_seen = (disparity > 0) & _is_inside(first, first_map) & (in_second | is_tall_seen)
    camera_height = float(min(first.centre_mm[2], second.centre_mm[2]))
    nearest = float(disparity[in_both].max(initial=1.0))
    heights = (MIN_HEIGHT_MM, min(MAX_HEIGHT_MM, MAX_SHARE_OF_CAMERA_HEIGHT * camera_height))
    low_px, high_px = (nearest * h / (camera_height - h) / (1.0 - a) for h in heights)
    return RectifiedPair(
        first_bgr=first_bgr,
        second_bgr=second_bgr,
        is_seen=is_seen,
        first_map_px=first_map,
        focal_px=focal,
        centre_px=(float(centre_x), float(centre_y)),
        rotation=rotation,
        first_centre_mm=first.centre_mm,
        baseline_mm=baseline_mm,
        plane_px=(float(a), float(b), float(c)),
        parallax_range_px=(low_px, high_px),
    )


def rectify_alone(view: View) -> RectifiedPair:
    """The grid of a single view: its photograph without distortion, turned no way."""
    rotation = view.rotation
    plane = -rotation[:, 2] / view.centre_mm[2]
    low, high = _own_bounds(view, plane)
    focal = min(
        float(np.sqrt(view.camera.fx * view.camera.fy)), WORKING_SIDE_PX / float((high - low).max())
    )
    width, height = (int(np.ceil(side * focal)) for side in high - low)
    centre_x, centre_y = -low * focal
    matrix = np.array([[focal, 0.0, centre_x], [0.0, focal, centre_y], [0.0, 0.0, 1.0]])
    a, b = plane[:2] * INVERSE_DEPTH_BASELINE_MM
    c = focal * INVERSE_DEPTH_BASELINE_MM * plane[2] - a * centre_x - b * centre_y
    first_bgr, first_map = warp_view(view, matrix, rotation, (width, height))
    disparity = a * np.arange(width)[None, :] + b * np.arange(height)[:, None] + c
    return RectifiedPair(
        first_bgr=first_bgr,
        second_bgr=None,
        is_seen=(disparity > 0) & _is_inside(view, first_map),
        first_map_px=first_map,
        focal_px=focal,
        centre_px=(float(centre_x), float(centre_y)),
        rotation=rotation,
        first_centre_mm=view.centre_mm,
        baseline_mm=INVERSE_DEPTH_BASELINE_MM,
        plane_px=(float(a), float(b), float(c)),
        parallax_range_px=(0.0, 0.0),
    )


def _lift(first: View, second: View) -> float:
    """By which share of itself the disparity of what stands TALL_MM high exceeds that of the plane under it."""
    camera_mm, lower_mm = (
        float(first.centre_mm[2]),
        float(min(first.centre_mm[2], second.centre_mm[2])),
    )
    tall_mm = min(TALL_MM, TALL_SHARE * lower_mm)
    return tall_mm / (camera_mm - tall_mm)


def _seen_bounds(
    first: View,
    second: View,
    rotation: Float64Array,
    plane: Float64Array,
    baseline_mm: float,
    lift: float = 0.0,
) -> tuple[Float64Array, Float64Array]:
    """(2,), (2,) least and greatest x / z, y / z of rectified rays that meet the plane within both views.

    lift: of a plane above it, see _lift; then also where the first view's rays would pass that meet the plane where the
    second view's do.
    """
    height, width = first.photo.pixels_bgr.shape[:2]
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 49))
    rays = undistort_to_rays(first, np.column_stack([columns.ravel(), rows.ravel()]))
    turned = homogeneous(rays) @ first.rotation @ rotation.T
    turned = turned[turned[:, 2] > 0]
    turned = turned / turned[:, 2:]
    inverse_depth = turned @ plane
    disparity = np.maximum(inverse_depth, 0.0) * baseline_mm
    from_second = turned - np.outer((1.0 + lift) * disparity, [1.0, 0.0, 0.0])
    in_second = from_second @ rotation @ second.rotation.T
    ahead = in_second[:, 2] > 0
    pixels = (
        in_second[:, :2]
        / np.where(ahead, in_second[:, 2], 1.0)[:, None]
        * [second.camera.fx, second.camera.fy]
    )
    pixels += [second.camera.cx, second.camera.cy]
    in_photo = (pixels >= 0).all(axis=1) & (pixels < second.photo.pixels_bgr.shape[1::-1]).all(
        axis=1
    )
    is_shared = ahead & in_photo & (inverse_depth > 0)
    if np.count_nonzero(is_shared) < 2:
        is_shared = np.ones(len(turned), np.bool_)
    shared = turned[is_shared, :2]
    if lift > 0:
        parallax = lift * disparity[is_shared] / (1.0 - plane[0] * baseline_mm)
        shared = np.concatenate([shared, shared - parallax[:, None] * [1.0, 0.0]])
    return shared.min(axis=0), shared.max(axis=0)


def _own_bounds(view: View, plane: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(2,), (2,) least and greatest x / z, y / z of a view's rays that meet the plane."""
    height, width = view.photo.pixels_bgr.shape[:2]
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 49))
    rays = homogeneous(undistort_to_rays(view, np.column_stack([columns.ravel(), rows.ravel()])))
    meets = rays @ plane > 0
    seen = rays[meets] if np.count_nonzero(meets) > 1 else rays
    return seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)


def warp_view(
    view: View, matrix: Float64Array, rotation: Float64Array, size: tuple[int, int]
) -> tuple[ImageArray, Float32Array]:
    """The photograph on the rectified grid, and (H, W, 2) each pixel's place in it. matrix: (3, 3) rectified K."""
    camera, pixels = view.camera, view.photo.pixels_bgr
    width, height = size
    # The map is smooth: computed on a grid of every eighth pixel, one point beyond each border, and interpolated.
    shrink = np.array(
        [
            [1.0 / MAP_STEP_PX, 0.0, 0.5 / MAP_STEP_PX + 0.5],
            [0.0, 1.0 / MAP_STEP_PX, 0.5 / MAP_STEP_PX + 0.5],
        ]
    )
    to_coarse = np.vstack([shrink, [0.0, 0.0, 1.0]])
    columns, rows = (-(-side // MAP_STEP_PX) for side in size)
    coarse, _ = cv2.initUndistortRectifyMap(
        camera.matrix,
        np.array(camera.distortion),
        rotation @ view.rotation.T,
        to_coarse @ matrix,
        (columns + 2, rows + 2),
        cv2.CV_32FC2,
    )
    wide = (coarse.shape[1] * MAP_STEP_PX, coarse.shape[0] * MAP_STEP_PX)
    whole = cv2.resize(coarse, wide, interpolation=cv2.INTER_LINEAR)
    first_map = np.ascontiguousarray(
        whole[MAP_STEP_PX : MAP_STEP_PX + height, MAP_STEP_PX : MAP_STEP_PX + width]
    )
    # Averaged before sampling, or fine texture aliases; by a whole factor, which takes a tenth of any other's time.
    factor = max(1, round(ALIASING_FREE * camera.fy / matrix[1, 1]))
    small = reduce_by(pixels, factor)
    in_small = (
        first_map
        if factor == 1
        else (first_map + np.float32(0.5)) / np.float32(factor) - np.float32(0.5)
    )
    # The stub asks for a second map, which two channels in the first make needless.
    warped = cv2.remap(small, in_small, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    return np.asarray(warped, np.uint8), np.asarray(first_map, np.float32)


def _is_inside(view: View, map_px: Float32Array) -> MaskArray:
    height, width = view.photo.pixels_bgr.shape[:2]
    x, y = map_px[..., 0], map_px[..., 1]
    return np.asarray((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1), np.bool_)
