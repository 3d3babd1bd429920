"""Smooth or glossy food of which only the edges could be measured: an orange on a cloth.

Heights and colours -> blobs that stand out although their middle shows no parallax: of colours that no support has.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.vision.geometry.masks import labelled, opened
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.colour_bins import byte_bins, colour_histogram, shaded_bins
from app.vision.scene.scene import FINE_REACH_PX, Scene

FLAT_MM = 3.0  # from a support's height: its surface
RAISED_MM = 15.0  # over the support: no plate's rim, no telephone, no cutlery
MIN_RAISED_MM2 = 20.0
MIN_BLOB_MM2 = 250.0
MAX_BLOB_MM2 = 40_000.0  # larger than any food: the background beyond the table
MIN_SUPPORT_PX = 500
# probability of a colour bin; a quarter of what it would be if all colours were alike
FAMILIAR = 1e-5
BESIDE_PX = 3


def unlike_support(
    scene: Scene, over_support_mm: Float32Array, shows_dish: Sequence[MaskArray]
) -> MaskArray:
    """(h, w) blobs of unfamiliar colour that stand out.

    over_support_mm: (h, w) height over the table, a board or a plate's floor, NaN where unmeasured. shows_dish: parts
    that show the dishes' own colours.
    """
    is_flat = (
        (np.abs(over_support_mm) < FLAT_MM) & (scene.reach_px < FINE_REACH_PX) & ~scene.is_ignored
    )
    is_raised = (over_support_mm > RAISED_MM) & ~scene.is_ignored
    is_support = np.any([is_flat, *shows_dish], axis=0)
    if np.count_nonzero(is_support) < MIN_SUPPORT_PX:
        return np.zeros(is_support.shape, np.bool_)
    bins = byte_bins(scene.image_bgr)
    is_unfamiliar = (
        colour_histogram([bins, *shaded_bins(scene.image_bgr)], is_support)[bins] < FAMILIAR
    )
    blobs = opened(is_unfamiliar & ~is_support & ~scene.is_ignored, BESIDE_PX)
    labels, stats, _ = labelled(blobs)
    near = cv2.dilate(labels.astype(np.uint16), np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8))
    raised = np.bincount(near[is_raised], minlength=len(stats))
    square_mm = scene.pixel_mm**2
    area_mm2 = stats[:, cv2.CC_STAT_AREA] * square_mm
    kept = (
        (area_mm2 > MIN_BLOB_MM2)
        & (area_mm2 < MAX_BLOB_MM2)
        & (raised * square_mm > MIN_RAISED_MM2)
    )
    kept[np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))] = (
        False  # goes on unseen
    )
    kept[0] = False
    return kept[labels]
