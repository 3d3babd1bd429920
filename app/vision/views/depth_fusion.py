"""Depth maps beside a pair, or beside a marker: brought to its scale by the table that both show, or refused.

DisparityMaps on one grid -> those that agree with the reference's table, in its scale; and the match with its gaps
filled. The marker decides the scale: of a sensor's error that varies slowly over the picture nothing is left.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from app.vision.model import Float32Array, MaskArray
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair

STEP_PX = 4  # of the grid, between the pixels by which a map is compared
MIN_COMPARED = 100
# phones' sensors are good to two per cent: more, and it is another unit or another scene
MAX_SCALE_ERROR = 0.1
MAX_TILT = 0.03  # of the scale, from the picture's middle to its border
TILT_PRIOR = 0.01
MIN_SHARE = 0.6  # of what is compared, within 3 sd and 1 % of depth
MAX_OFF = (3.0, 0.01)  # standard deviations, share of the depth
ROUNDS = 4
AGREEING_SD = 3.0
FILLING_SD_MM = 2.0  # of depth: a noisier map shows no plate's rim
FILLING_WINDOW_PX = 61  # the most that is averaged: half a food of 50 mm at 500 mm
MIN_WINDOW_SHARE = 0.5  # of it that is measured


def agree_with_table(
    pair: RectifiedPair,
    measured: DisparityMap,
    table_px: Float32Array,
    is_table: MaskArray,
    *,
    has_tilt: bool,
) -> DisparityMap | None:
    """The map in the scale that the reference has on the table; None where they do not agree.

    measured: a map with its sd, on the pair's grid. table_px: (H, W) parallax of the table by the reference, which
    is_table says where to compare. has_tilt: the scale may vary over the picture, which a marker's sheet alone is too
    small to tell.
    """
    window = (slice(None, None, STEP_PX), slice(None, None, STEP_PX))
    shown = pair.disparity_from_parallax(measured.parallax_px)
    expected = pair.disparity_from_parallax(table_px)
    compared = is_table[window] & np.isfinite(shown[window]) & np.isfinite(expected[window])
    if np.count_nonzero(compared) < MIN_COMPARED or measured.sd_px is None:
        return None
    height, width = pair.shape
    x, y = (np.linspace(-1.0, 1.0, side) for side in (width, height))
    rows, columns = (index * STEP_PX for index in np.nonzero(compared))
    design = np.column_stack([np.ones(len(rows)), x[columns], y[rows]])
    ratio = shown[rows, columns].astype(np.float64) / expected[rows, columns]
    noise = measured.sd_px[rows, columns] / expected[rows, columns]
    coefficients = np.array([np.median(ratio), 0.0, 0.0])
    tilt_precision = TILT_PRIOR**-2 if has_tilt else 1e12
    prior = np.diag([0.0, tilt_precision, tilt_precision])
    # So many of the compared pixels count as one observation.
    per_fact = max(1.0, (measured.error_area_px or 1.0) / STEP_PX**2)
    is_near = np.ones(len(ratio), np.bool_)
    for _ in range(ROUNDS):
        is_near = np.abs(ratio - design @ coefficients) < MAX_OFF[0] * noise + MAX_OFF[1]
        weighted = design[is_near] / (noise[is_near] ** 2 * per_fact)[:, None]
        normal = weighted.T @ design[is_near] + prior
        if np.count_nonzero(is_near) < MIN_COMPARED:
            return None
        coefficients = np.linalg.solve(normal, weighted.T @ ratio[is_near])
    scale, *tilt = coefficients
    if (
        np.mean(is_near) < MIN_SHARE
        or abs(scale - 1.0) > MAX_SCALE_ERROR
        or np.abs(tilt).max() > MAX_TILT
    ):
        return None
    by = (coefficients[0] + coefficients[1] * x + coefficients[2] * y[:, None]).astype(np.float32)
    return replace(
        measured, parallax_px=pair.parallax_from_disparity(shown / by), sd_px=measured.sd_px / by
    )


def fuse_depths(
    pair: RectifiedPair,
    match: DisparityMap,
    maps: Sequence[DisparityMap],
    match_sd_px: float,
    *,
    is_averaged: bool,
) -> DisparityMap:
    """The match and the maps weighted by their precision; where they disagree, and where the match failed, the surer.

    match_sd_px: least, of the match. A noisy map fills gaps by its average over a window, and none if that would be as
    wide as a food; is_averaged: of a dense match, which is one over its windows already, only what is sure fills any.
    """
    parallax, reach = match.parallax_px.copy(), match.reach_px.copy()
    sd = np.full(parallax.shape, match_sd_px, np.float32)
    if match.sd_px is not None:
        sd = np.fmax(match.sd_px, sd)
    sd[np.isnan(parallax)] = np.nan
    for each in maps:
        if each.sd_px is None:
            continue
        is_shown = np.isfinite(each.parallax_px) & pair.is_seen
        filling, filling_sd = (
            _sure(pair, each, each.sd_px) if is_averaged else _smooth(pair, each, each.sd_px)
        )
        is_filled = np.isnan(parallax) & np.isfinite(filling.parallax_px) & pair.is_seen
        is_surer = is_shown & (each.sd_px < sd)
        is_one = is_shown & (
            np.abs(each.parallax_px - parallax) < AGREEING_SD * np.hypot(sd, each.sd_px)
        )
        share = sd**2 / (sd**2 + each.sd_px**2)
        mixed = parallax + share * (each.parallax_px - parallax)
        parallax = np.where(is_one, mixed, np.where(is_surer, each.parallax_px, parallax))
        sd = np.where(is_one, np.sqrt(share) * each.sd_px, np.where(is_surer, each.sd_px, sd))
        reach = np.where(is_surer, each.reach_px, reach)
        parallax = np.where(is_filled, filling.parallax_px, parallax)
        sd = np.where(is_filled, filling_sd, sd)
        reach = np.where(is_filled, filling.reach_px, reach)
    return DisparityMap(parallax, reach, sd)


def _sure(
    pair: RectifiedPair, measured: DisparityMap, sd_px: Float32Array
) -> tuple[DisparityMap, Float32Array]:
    """The map where its sd is below FILLING_SD_MM, NaN elsewhere, and its sd."""
    is_sure = sd_px < FILLING_SD_MM * _per_mm(pair, measured)
    return replace(
        measured, parallax_px=np.where(is_sure, measured.parallax_px, np.float32(np.nan))
    ), sd_px


def _per_mm(pair: RectifiedPair, measured: DisparityMap) -> Float32Array:
    """(H, W) px of disparity for one mm of depth."""
    squared = pair.disparity_from_parallax(measured.parallax_px) ** 2
    return squared / np.float32(pair.focal_px * pair.baseline_mm)


def _smooth(
    pair: RectifiedPair, measured: DisparityMap, sd_px: Float32Array
) -> tuple[DisparityMap, Float32Array]:
    """The map averaged until its noise is FILLING_SD_MM, its reach widened by the window, and its sd.

    NaN where that takes too wide a window.
    """
    nothing = np.full(pair.shape, np.nan, np.float32)
    is_measured = np.isfinite(measured.parallax_px)
    if not is_measured.any():
        return measured, nothing
    sd_mm = float(np.nanmedian(sd_px / _per_mm(pair, measured)))
    side = max(1, int(np.ceil(np.sqrt(measured.error_area_px or 1.0) * sd_mm / FILLING_SD_MM)))
    if side > FILLING_WINDOW_PX:
        return replace(measured, parallax_px=nothing), nothing
    share = cv2.boxFilter(is_measured.astype(np.float32), cv2.CV_32F, (side, side))
    total = cv2.boxFilter(
        np.where(is_measured, measured.parallax_px, np.float32(0.0)), cv2.CV_32F, (side, side)
    )
    mean = np.where(
        share > MIN_WINDOW_SHARE, total / np.maximum(share, np.float32(MIN_WINDOW_SHARE)), nothing
    )
    reach = measured.reach_px + np.float32((side - 1) / 2)
    smooth = replace(measured, parallax_px=mean, reach_px=reach)
    return smooth, sd_px * np.float32(min(1.0, FILLING_SD_MM / sd_mm))
