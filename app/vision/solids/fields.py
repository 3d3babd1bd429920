"""What the views show of a food, as fields that can be asked between the pixels: both sides of a fit's misfits.

An outline -> the signed distance from it; a map of parallax -> its value, its sd and whether it is known. Values change
continuously with the place, so that a fit's cost does.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.masks import window_around
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.solids.outline_snap import STEP_PX, Outline
from app.vision.tuning import TUNING


@dataclass(frozen=True, slots=True)
class OutlineField:
    """An outline in a window of a view, (2, h, w): its signed distance, px, positive outside, and its weight.

    origin: (2,) x, y of the window's first pixel. length_px: of the outline, by its weight.
    """

    distance_and_weight: Float32Array
    origin: Float64Array
    length_px: float

    def at(self, pixels: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """(n,) distance, (n, 2) its derivative by the place, and (n,) weight, at (n, 2) px."""
        height, width = self.distance_and_weight.shape[1:]
        within = pixels - self.origin
        inside = np.clip(within, 0.0, [width - 1.001, height - 1.001])
        corners, shares, (x, y) = _around(inside, self.distance_and_weight)
        here, right, below, across = corners[0]
        slope = np.column_stack(
            [
                (1 - y) * (right - here) + y * (across - below),
                below - here + x * (across - right - below + here),
            ]
        )
        beyond = within - inside
        apart = np.sqrt((beyond**2).sum(axis=1))
        is_beyond = apart > 0
        slope[is_beyond] = beyond[is_beyond] / apart[is_beyond, None]
        distance, weight = np.einsum("kn,ckn->cn", shares, corners)
        return distance + apart, slope, weight


def outline_field(line: Outline) -> OutlineField:
    """The field around an outline."""
    low = np.floor(line.points_px.min(axis=0)) - TUNING.field_margin_px
    width, height = (np.ceil(line.points_px.max(axis=0)) + TUNING.field_margin_px - low + 1).astype(
        np.int64
    )
    seeds = np.ones((height, width), np.uint8)
    column, row = np.rint(line.points_px - low).astype(np.int64).T
    seeds[row, column] = 0
    _, label = cv2.distanceTransformWithLabels(
        seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    nearest = np.zeros(int(label.max()) + 1, np.int64)
    nearest[label[row, column]] = np.arange(len(row))
    point = nearest[label]
    grid_y, grid_x = np.mgrid[:height, :width].astype(np.float32)
    origin = line.points_px - low
    apart_x = grid_x - origin[:, 0].astype(np.float32)[point]
    apart_y = grid_y - origin[:, 1].astype(np.float32)[point]
    normal_x, normal_y = (line.normals[:, axis].astype(np.float32)[point] for axis in (0, 1))
    outward = apart_x * normal_x + apart_y * normal_y
    along = np.abs(apart_y * normal_x - apart_x * normal_y)
    beside = np.maximum(along - np.float32(STEP_PX / 2), 0)
    distance = np.copysign(np.hypot(outward, beside), outward)
    weight = line.weights.astype(np.float32)[point]
    smooth = [
        cv2.blur(picture, (side, side))
        for picture, side in ((distance, TUNING.smooth_px), (weight, TUNING.smooth_weight_px))
    ]
    return OutlineField(
        np.stack(smooth),
        low,
        STEP_PX * float(line.weights.sum()),
    )


@dataclass(frozen=True, slots=True)
class ParallaxField:
    """Parallax in a window of the grid, averaged over a few pixels; where less is known, over fewer.

    pictures: (3, h, w) the parallax, its sd, and the share of those pixels that is known; the first two, px, are that
    share times the mean of what is known, so that what is not known has no part in a place between the pixels.
    area_px: over which errors are one. known_px: area that could be measured. origin: (2,) x, y of the window's first
    pixel. is_measurement: the sd is of the measurement alone: what the food itself departs from its form comes on top.
    """

    pictures: Float32Array
    area_px: float
    known_px: float
    origin: tuple[int, int]
    is_measurement: bool = False

    def at(self, pixels: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """(n,) value, its sd and how far it is known, 0 to 1, at (n, 2) px."""
        height, width = self.pictures.shape[1:]
        place = pixels - self.origin
        is_inside = np.all((place >= 0) & (place < [width - 1, height - 1]), axis=1)
        corners, shares, _ = _around(np.where(is_inside[:, None], place, 0.0), self.pictures)
        value, sd, known = np.einsum("kn,ckn->cn", shares, corners)
        least = np.maximum(known, 1e-6)
        sd = np.maximum(sd / least, TUNING.least_sd_px)
        return value / least, sd, np.minimum(2 * known, 1.0) * is_inside


def parallax_field(
    parallax_px: Float32Array,
    sd_px: Float32Array,
    is_known: MaskArray,
    area_px: float,
    origin: tuple[int, int] = (0, 0),
    *,
    known_px: float | None = None,
    is_measurement: bool = False,
) -> ParallaxField | None:
    """The field of what is known of a map; None if nothing is. All (H, W); origin: x, y of their first pixel.

    known_px: area that could be known, if not that which is. The field's errors are one over the pixels of an average,
    and it reaches half as far beyond what is known.
    """
    if not is_known.any():
        return None
    rows, columns = window_around(is_known, TUNING.averaged_px)
    is_known = is_known[rows, columns]

    own = [parallax_px[rows, columns], sd_px[rows, columns], np.ones_like(is_known, np.float32)]
    side = (TUNING.averaged_px, TUNING.averaged_px)
    averaged = [
        cv2.blur(np.where(is_known, each, np.float32(0)), side, borderType=cv2.BORDER_CONSTANT)
        for each in own
    ]
    return ParallaxField(
        np.stack(averaged),
        area_px,
        known_px or float(np.count_nonzero(is_known)),
        (origin[0] + columns.start, origin[1] + rows.start),
        is_measurement=is_measurement,
    )


def _around(
    places: Float64Array, pictures: Float32Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """What pictures (c, h, w) show at the four pixels around places (n, 2), and between which of them these lie.

    (c, 4, n) values, (4, n) the share of each pixel, and (2, n) x and y beyond the first.
    """
    count, _, width = pictures.shape
    whole = places.astype(np.int64)
    x, y = between = (places - whole).T
    first = whole[:, 1] * width + whole[:, 0]
    four = np.stack([first, first + 1, first + width, first + width + 1])
    corners = pictures.reshape(count, -1).take(four, axis=1).astype(np.float64)
    return corners, np.stack([(1 - y) * (1 - x), (1 - y) * x, y * (1 - x), y * x]), between
