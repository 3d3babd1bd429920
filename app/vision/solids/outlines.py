"""Between the rectified grid and the photographs as they were sent: hints in, outlines out.

Whichever view stands on the left, measuring happens on its rectified grid; people see the photographs that they named
left and right.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.vision.geometry.mesh import IntArray
from app.vision.model import Float32Array, Float64Array, Hint, MaskArray, View
from app.vision.scene.segmentation import HintMask
from app.vision.solids.surface_match import draw_mask
from app.vision.views.rectification import RectifiedPair

POINT_RADIUS_SHARE = 0.008  # of the long side: a fingertip
# of the long side, to a point that no pixel shows; and beyond the nearest one
NEAREST_SHARE, NEAREST_PX = 0.05, 8.0
TOLERANCE_PX = 1.5  # of an outline's corners, in the photograph
DECIMALS = 1
IN_VESSEL = ("in_vessel", "liquid")  # forms of a food that a vessel holds
MIN_HOLE_SHARE = 0.01  # of the outline's area; smaller holes are noise
SPLAT_SIDE_PX = 1000  # of the reduced photograph that a mask is carried over to


def photograph_px(
    pair: RectifiedPair, points_table: Float32Array, left: View, *, is_swapped: bool
) -> Float32Array:
    """(H, W, 2) each grid pixel's place in the photograph sent as left, px.

    That photograph is the grid's own unless the pair came swapped; then the place follows from the pixel's point, or
    the nearest measured one. (The same way round for the one sent as right, which is the grid's own if it did.)
    """
    if not is_swapped:
        return pair.first_map_px
    is_measured = np.isfinite(points_table[..., 2])
    if not is_measured.any():
        return np.full((*pair.shape, 2), np.nan, np.float32)
    _, nearest = cv2.distanceTransformWithLabels(
        (~is_measured).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    point_of = np.zeros((int(nearest.max()) + 1, 3))
    point_of[nearest[is_measured]] = points_table[is_measured]
    return np.asarray(points_in_photograph(point_of, left).astype(np.float32)[nearest], np.float32)


def draw_hints(
    hints: Sequence[Hint], places_px: Float32Array, size: tuple[int, int]
) -> list[HintMask]:
    """Each hint as a mask on the grid. places_px: (H, W, 2). size: of the photograph sent as left (width, height)."""
    drawn = []
    columns, rows = (np.nan_to_num(places_px[..., axis], nan=-1.0) for axis in (0, 1))
    for index, hint in enumerate(hints):
        picture = np.zeros((size[1], size[0]), np.uint8)
        is_box = hint.polygon is None and hint.box is not None
        if hint.polygon is not None:
            cv2.fillPoly(
                picture, [np.rint(np.array(ring)).astype(np.int32) for ring in hint.polygon], 1
            )
        elif hint.box is not None:
            x, y, width, height = hint.box
            cv2.rectangle(
                picture, (round(x), round(y)), (round(x + width), round(y + height)), 1, -1
            )
        elif hint.point is not None:
            radius = round(POINT_RADIUS_SHARE * max(size))
            cv2.circle(picture, (round(hint.point[0]), round(hint.point[1])), radius, 1, -1)
        else:
            continue
        mask = (
            cv2.remap(picture, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT) > 0
        )
        if hint.point is not None and hint.box is None and hint.polygon is None and not mask.any():
            mask = _nearest_to(hint.point, places_px, size)
        is_in_vessel = hint.vessel is not None or (hint.form or hint.lies_as) in IN_VESSEL
        drawn.append(HintMask(mask, index, hint.polygon is not None, is_box, is_in_vessel))
    return drawn


def _nearest_to(
    point: tuple[float, float], places_px: Float32Array, size: tuple[int, int]
) -> MaskArray:
    """(H, W) the grid's pixels nearest to a point in the photograph that none of them shows, if they are near.

    The grid of a swapped pair knows only where what is measured lies in the photograph sent as left.
    """
    apart = np.nan_to_num(
        np.hypot(places_px[..., 0] - point[0], places_px[..., 1] - point[1]), nan=np.inf
    )
    is_inside = 0 <= point[0] < size[0] and 0 <= point[1] < size[1]
    if not is_inside or apart.min() > NEAREST_SHARE * max(size):
        return np.zeros(apart.shape, np.bool_)
    return np.asarray(apart <= apart.min() + NEAREST_PX, np.bool_)


def rings_of(
    mask: MaskArray, places_px: Float32Array, *, is_swapped: bool
) -> tuple[Float64Array, ...]:
    """Outlines of a mask in the photograph sent as left: outer ring, then holes, (n, 2) px; empty if nothing is."""
    if not is_swapped:
        return tuple(_simplified(places_px[ring[:, 1], ring[:, 0]]) for ring in _rings(mask))
    places = places_px[mask]
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) == 0:
        return ()
    low = np.floor(places.min(axis=0))
    scale = min(1.0, SPLAT_SIDE_PX / float(np.ptp(places, axis=0).max() + 1))
    # A pixel of the grid covers about this many of the photograph: the splats are closed by so much.
    spread = max(
        3, 2 * int(np.ceil(scale * np.sqrt(np.prod(np.ptp(places, axis=0) + 1) / len(places)))) + 3
    )
    cells = np.rint((places - low) * scale).astype(np.int64) + spread
    width, height = cells.max(axis=0) + spread + 1
    picture = np.zeros((int(height), int(width)), np.uint8)
    picture[cells[:, 1], cells[:, 0]] = 1
    closed = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((spread, spread), np.uint8)) > 0
    return tuple(_simplified((ring - spread) / scale + low) for ring in _rings(closed))


def rings_of_faces(
    pixels: Float64Array, faces: IntArray, size: tuple[int, int]
) -> tuple[Float64Array, ...]:
    """Outlines of what triangles with corners at (n, 2) px of a photograph cover in it; empty if nothing is.

    size: of the photograph (width, height).
    """
    if len(pixels) == 0 or not np.isfinite(pixels).all():
        return ()
    low = np.floor(np.clip(pixels.min(axis=0), 0, size))
    high = np.ceil(np.clip(pixels.max(axis=0), 0, np.array(size) - 1))
    if (high <= low).any():
        return ()
    scale = min(1.0, SPLAT_SIDE_PX / float((high - low).max()))
    border = 1  # so that the contour closes where the photograph ends
    width, height = (np.ceil((high - low) * scale)).astype(np.int64) + 1 + 2 * border
    covered = draw_mask((pixels - low) * scale + border, faces, (int(height), int(width)))
    covered[[0, -1]] = covered[:, [0, -1]] = False
    return tuple(_simplified((ring - border) / scale + low) for ring in _rings(covered))


def points_in_photograph(points_table: Float64Array, view: View) -> Float64Array:
    """(n, 3) mm -> (n, 2) px of the photograph, with its lens's distortion."""
    camera = view.camera
    projected, _ = cv2.projectPoints(
        np.ascontiguousarray(points_table, np.float64),
        cv2.Rodrigues(view.rotation)[0],
        view.translation_mm,
        camera.matrix,
        np.array(camera.distortion),
    )
    return np.asarray(projected, np.float64).reshape(-1, 2)


def second_grid_in_photograph(
    pixels: Float64Array, pair: RectifiedPair, second: View
) -> Float64Array:
    """(n, 2) px of the second image of the rectified grid -> (n, 2) px of the second photograph."""
    a, b, c = pair.plane_px
    x, y = pixels.T
    unsheared = np.column_stack([x * (1 - a) - b * y - c, y])
    # Somewhere on each ray: where it is seen does not depend on how far away it is.
    return points_in_photograph(
        pair.rays(unsheared) @ pair.rotation * pair.focal_px + second.centre_mm, second
    )


def _rings(mask: MaskArray) -> list[np.ndarray]:
    """Contour of the largest component and its larger holes, (n, 2) int, on the mask's grid."""
    contours, hierarchy = cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    if not contours:
        return []
    areas = [cv2.contourArea(contour) for contour in contours]
    tree = np.asarray(hierarchy).reshape(-1, 4)
    outer = max((k for k in range(len(contours)) if tree[k][3] < 0), key=lambda k: areas[k])
    holes = [
        k
        for k in range(len(contours))
        if tree[k][3] == outer and areas[k] > MIN_HOLE_SHARE * areas[outer]
    ]
    return [np.asarray(contours[k]).reshape(-1, 2) for k in (outer, *holes)]


def _simplified(ring: np.ndarray) -> Float64Array:
    """The ring without corners that change it by less than TOLERANCE_PX, to tenths of a pixel, as it is kept."""
    simple = cv2.approxPolyDP(
        np.ascontiguousarray(ring, np.float32).reshape(-1, 1, 2), TOLERANCE_PX, closed=True
    )
    return np.round(np.asarray(simple, np.float64).reshape(-1, 2), DECIMALS)
