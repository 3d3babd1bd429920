"""Find the height of the plane that an area shows, by comparing both views at one height after another.

No window has to be matched: the grain of a board tells its height where no pixel's height is known.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from app.vision.geometry.masks import window_around
from app.vision.geometry.pictures import blurred, grey_of
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.tuning import FLOOR_TUNING
from app.vision.views.rectification import RectifiedPair


@dataclass(frozen=True, slots=True)
class PlaneSweep:
    """Both views on the scene's grid.

    pictures: (h, w) each, grey levels without noise
    plane_px: (a, b, c), the marker plane's disparity a x + b y + c
    camera_mm: height of the first camera over the marker's plane
    """

    pictures: tuple[Float32Array, Float32Array]
    plane_px: tuple[float, float, float]
    camera_mm: float

    @classmethod
    def of_pair(cls, pair: RectifiedPair, reduction: int) -> Self | None:
        """Return the sweep of a pair on its grid reduced by a whole factor; None for a single view."""
        if pair.second_bgr is None:
            return None
        first, second = (_fine(image, reduction) for image in pair.both_bgr)
        a, b, c = pair.plane_px
        return cls((first, second), (a, b, c / reduction), float(pair.first_centre_mm[2]))

    def log_likelihoods(self, area: MaskArray, heights_mm: Float64Array) -> Float64Array:
        """Return (n,) log likelihoods of planes, all alike if the area shows too little.

        area: (h, w)
        heights_mm: (n,) of the planes over the marker's
        """
        window = window_around(area, 0)
        shown = area[window]
        coarse_px = FLOOR_TUNING.detail_px[1]
        share = blurred(shown.astype(np.float32), coarse_px)
        inner = shown & (share > FLOOR_TUNING.inner_share)
        if np.count_nonzero(inner) < FLOOR_TUNING.least_px:
            return np.zeros(len(heights_mm))

        def grain(picture: Float32Array) -> Float32Array:
            """Return (n,) grey levels over their slow course, which nothing beside the area has a part in."""
            within = np.where(shown, picture, np.float32(0.0))
            course = blurred(within, coarse_px)[inner] / share[inner]
            return picture[inner] - course

        first = grain(self.pictures[0][window])
        limit = np.float32(FLOOR_TUNING.grain_sds * 1.48 * np.median(np.abs(first)))
        is_grain = np.abs(first) <= limit
        first = first[is_grain]
        correlations = np.zeros(len(heights_mm))
        for place, height_mm in enumerate(heights_mm):
            second = grain(self._second_at(float(height_mm), window))[is_grain]
            second = np.clip(second, -limit, limit)
            norm = float(np.sqrt((first @ first) * (second @ second)))
            correlations[place] = float(first @ second) / max(norm, 1e-6)
        unexplained = 1.0 - np.clip(correlations, 0.0, FLOOR_TUNING.most_correlation) ** 2
        facts = 1.0 / (FLOOR_TUNING.px_per_fact / len(first) + 1.0 / FLOOR_TUNING.most_facts)
        return np.asarray(-0.5 * facts * np.log(unexplained))

    def _second_at(self, height_mm: float, window: tuple[slice, slice]) -> Float32Array:
        """Return the second view as the first view would see it on a plane. window: rows, columns."""
        a, b, c = self.plane_px
        share = height_mm / (self.camera_mm - height_mm) / (1.0 - a)
        top, left = window[0].start, window[1].start
        size = (window[1].stop - left, window[0].stop - top)
        corner = left - share * (a * left + b * top + c)
        shift = np.array([[1.0 - share * a, -share * b, corner], [0.0, 1.0, top]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(self.pictures[1], shift, size, flags=flags), np.float32)


def _fine(image_bgr: ImageArray, reduction: int) -> Float32Array:
    height, width = (-(-side // reduction) for side in image_bgr.shape[:2])
    grey = cv2.resize(grey_of(image_bgr), (width, height), interpolation=cv2.INTER_AREA)
    return blurred(grey.astype(np.float32), FLOOR_TUNING.detail_px[0])
