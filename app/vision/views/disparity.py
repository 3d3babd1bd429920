"""Dense disparity: semi-global matching finds it, normalised windows settle it to sub-pixel, checked both ways.

Two images whose rows are epipolar lines -> parallax of every pixel, NaN where unmatched. The pair comes sheared by the
support's plane (rectification.py), so that a window on the support, the most slanted surface of a meal, needs no slant
of its own; each pixel of a window moves by the parallax found before, so that a window follows any smooth surface.
Where a fine window shows nothing but noise, a larger one on a coarser level stands in. The windows maximise the
normalised cross correlation (paper, section IV.D). The finest level is settled only where something stands.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.pictures import grey_of
from app.vision.model import Float32Array, ImageArray, MaskArray

# reductions: the whole range is searched on the first, what it found on the second
RANGE_LEVEL, SEARCH_LEVEL = 4, 2
# on the range level: 30 px across at full size; what is smaller does not widen the search
RANGE_SPECKLE_PX = 60
RANGE_MARGIN_PX = 16.0  # at full size, beyond what was found
STANDING_PX = 1.5  # over the support, at full size: 3 to 5 mm at usual distances; what is lower needs no finer level
STANDING_MARGIN_PX = 24  # around what stands
LEVELS = (4, 2, 1)  # reductions on which windows settle; a finer one overrides a coarser one
STEPS = 2  # of Gauss-Newton on each level; the search leaves half a pixel, the level before a tenth
WINDOW_PX = 9  # on each level: 36, 18 and 9 px of the working image
# Hirschmueller (2008), P1 and P2, for windows of 3 x 3 px
SMALL_STEP_PENALTY, LARGE_STEP_PENALTY = 100, 500
SEARCH_WINDOW_PX = 3
MIN_CORRELATION = 0.6
MIN_TEXTURE = 1.0  # grey levels, standard deviation in a window: below, it is the sensor's noise that is correlated
MAX_SD_PX = 0.35  # of the level's pixels, by what the window's fit leaves
MAX_CHECK_DIFFERENCE_PX = 1  # on the search level, between the parallax from either view
MAX_MOVE_PX = 1.0  # of the level's pixels, from where a level starts; further off, it is another place that is alike
BAND_ROWS = 96
INDEPENDENT_SHARE = 0.3  # of a window's pixels: demosaicing, compression and resampling tie neighbours' noise together
SPECKLE_PX = 100  # smaller islands of parallax that hang together with nothing are mismatches
SPECKLE_STEP_PX = 2
COLOUR_REACH_PX = 6.0


@dataclass(frozen=True, slots=True)
class DisparityMap:
    """parallax_px: (H, W) of the first image, NaN where unmatched. reach_px: (H, W) half the window of each.

    error_area_px: over which errors are one; None: as of dense matching. sd_px: (H, W) of each parallax, NaN where
    unmatched. Within the reach of
    an object's outline a parallax may be that of the other side.
    """

    parallax_px: Float32Array
    reach_px: Float32Array
    sd_px: Float32Array | None = None
    error_area_px: float | None = None


def unmatched(shape: tuple[int, int]) -> DisparityMap:
    """The map of a single view, in which nothing is measured. shape: (H, W).

    Its reach tells the segmentation how far outlines by colour alone may be from the true ones.
    """
    nothing = np.full(shape, np.nan, np.float32)
    return DisparityMap(nothing, np.full(shape, COLOUR_REACH_PX, np.float32), nothing)


def match_dense(
    first_bgr: ImageArray,
    second_bgr: ImageArray,
    range_px: tuple[float, float],
    is_seen: MaskArray | None = None,
) -> DisparityMap:
    """Parallax x_first - x_second, kept where both directions of the search agree and a window confirms it.

    first_bgr, second_bgr: (H, W, 3). range_px: least and greatest parallax. is_seen: (H, W) where to keep any.
    """
    first = grey_of(first_bgr)
    second = grey_of(second_bgr)
    height, width = first.shape
    searched, is_confirmed = _search(first, second, range_px, is_seen)
    parallax = np.full((height, width), np.nan, np.float32)
    reach = np.zeros((height, width), np.float32)
    sd = np.full((height, width), np.nan, np.float32)
    start = searched
    for level in LEVELS:
        size = _level_size(first, level)
        a, b = (_resized(grey, size, cv2.INTER_AREA) for grey in (first, second))
        scale = np.float32(width / size[0])
        rows, columns = (
            _standing(np.where(is_confirmed > 0, start, np.float32(0.0)))
            if level == LEVELS[-1]
            else (slice(None), slice(None))
        )
        begun = (_resized(start, size, cv2.INTER_LINEAR) / scale).astype(np.float32)[rows, columns]
        settled = _settle(a[rows, columns], b[rows], begun, level, columns.start or 0)
        is_good = settled.is_good & (
            _resized(is_confirmed, size, cv2.INTER_NEAREST)[rows, columns] > 0
        )
        good = np.where(is_good, settled.parallax * scale, np.float32(np.nan))
        whole = (good.shape[1], good.shape[0]) if level == LEVELS[-1] else (width, height)
        kept = _resized(good, whole, cv2.INTER_LINEAR)
        is_kept = np.isfinite(kept)
        np.copyto(parallax[rows, columns], kept, where=is_kept)
        reach[rows, columns][is_kept] = level * WINDOW_PX / 2
        np.copyto(
            sd[rows, columns], _resized(settled.sd * scale, whole, cv2.INTER_LINEAR), where=is_kept
        )
        if level == SEARCH_LEVEL:  # the finest level sets out from here
            start = np.where(is_good, settled.parallax, begun) * scale
    parallax = _without_speckles(parallax)
    sd[np.isnan(parallax)] = np.nan
    return DisparityMap(parallax, reach, sd)


@dataclass(frozen=True, slots=True)
class _Settled:
    """One level's parallax (H, W) and its standard deviation, px of that level, and where it can be trusted."""

    parallax: Float32Array
    sd: Float32Array
    is_good: MaskArray


def _search(
    first: ImageArray, second: ImageArray, range_px: tuple[float, float], is_seen: MaskArray | None
) -> tuple[Float32Array, ImageArray]:
    """Parallax of each pixel on the search level, px of full size, and 1 where it is seen and both directions agree."""
    parallax, agrees = _search_range(first, second, range_px, RANGE_LEVEL, is_seen)
    offset = 1.0 - min(0.0, float(parallax.min()))
    is_alike = (_inner(is_seen, agrees.shape) > 0) & looks_alike(first, second, parallax)
    kept = np.where(agrees & is_alike, parallax + offset, 0.0).astype(np.int16)
    cv2.filterSpeckles(kept, 0, RANGE_SPECKLE_PX, SPECKLE_STEP_PX * RANGE_LEVEL)
    seen = kept[kept > 0] - offset
    if seen.size:
        low, high = float(seen.min()) - RANGE_MARGIN_PX, float(seen.max()) + RANGE_MARGIN_PX
        range_px = (max(range_px[0], low), min(range_px[1], high))
    parallax, agrees = _search_range(first, second, range_px, SEARCH_LEVEL, is_seen)
    return parallax, agrees & _inner(is_seen, agrees.shape)


def looks_alike(first: ImageArray, second: ImageArray, parallax_px: Float32Array) -> MaskArray:
    """(h, w) where windows of both images correlate: on a plain table a search takes the sensor's noise for a match.

    first, second: (H, W), compared on the grid of parallax_px, (h, w), which is in px of the images.
    """
    height, width = parallax_px.shape
    a, b = (
        _resized(grey, (width, height), cv2.INTER_AREA).astype(np.float32)
        for grey in (first, second)
    )
    columns = np.arange(width, dtype=np.float32) - parallax_px * np.float32(width / first.shape[1])
    seen = _sample(b, columns, cv2.INTER_LINEAR)
    mean, mean_seen = _box(a), _box(seen)
    variance, variance_seen = _box(a * a) - mean * mean, _box(seen * seen) - mean_seen * mean_seen
    together = _box(a * seen) - mean * mean_seen
    limit = np.float32(MIN_CORRELATION) * np.sqrt(
        np.maximum(variance * variance_seen, np.float32(1e-6))
    )
    return np.asarray(together > limit, np.bool_)


def _inner(is_seen: MaskArray | None, shape: tuple[int, ...]) -> ImageArray:
    """(H, W) 1 where windows of the coarsest level see nothing but the scene, on a level of this shape."""
    if is_seen is None:
        return np.ones(shape, np.uint8)
    small = _resized(is_seen.astype(np.uint8), (shape[1], shape[0]), cv2.INTER_NEAREST)
    side = round(LEVELS[0] * WINDOW_PX * shape[1] / is_seen.shape[1]) + 1
    return np.asarray(
        cv2.erode(
            small, np.ones((side, side), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
        ),
        np.uint8,
    )


def _search_range(
    first: ImageArray,
    second: ImageArray,
    range_px: tuple[float, float],
    level: int,
    is_seen: MaskArray | None,
) -> tuple[Float32Array, ImageArray]:
    size = _level_size(first, level)
    a, b = (_resized(grey, size, cv2.INTER_AREA) for grey in (first, second))
    b = _with_light_of(b, a, _inner(is_seen, a.shape))
    scale = first.shape[1] / size[0]
    low = int(np.floor(range_px[0] / scale)) - 1
    count = 16 * int(np.ceil((range_px[1] / scale + 2 - low) / 16))
    matcher = cv2.StereoSGBM.create(
        low,
        count,
        SEARCH_WINDOW_PX,
        SMALL_STEP_PENALTY,
        LARGE_STEP_PENALTY,
        disp12MaxDiff=MAX_CHECK_DIFFERENCE_PX,
        preFilterCap=63,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    parallax = _semi_global(matcher, a, b, low, count)
    agrees = parallax >= low
    columns = np.arange(size[0], dtype=np.float32) - parallax
    agrees &= (columns >= 0) & (columns <= size[0] - 1)
    return _filled(parallax, agrees) * np.float32(scale), agrees.astype(np.uint8)


def _standing(parallax: Float32Array) -> tuple[slice, slice]:
    """Rows and columns, at full size, of the rectangle around all that stands over the support; all if nothing does.

    parallax: (H, W) on the search level, px of full size.
    """
    stands = np.where(parallax > STANDING_PX, np.int16(1), np.int16(0))
    cv2.filterSpeckles(stands, 0, SPECKLE_PX, 0)
    rows, columns = (np.flatnonzero(stands.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return slice(None), slice(None)
    row_range, column_range = (
        slice(
            max(0, int(indices[0]) * SEARCH_LEVEL - STANDING_MARGIN_PX),
            (int(indices[-1]) + 1) * SEARCH_LEVEL + STANDING_MARGIN_PX,
        )
        for indices in (rows, columns)
    )
    return row_range, column_range


def _semi_global(
    matcher: cv2.StereoSGBM, a: ImageArray, b: ImageArray, low: int, count: int
) -> Float32Array:
    """(H, W) parallax; the image is widened by the range, since none is searched for within it of the border."""
    left, right = max(0, low + count), max(0, -low)
    wide = [cv2.copyMakeBorder(image, 0, 0, left, right, cv2.BORDER_REPLICATE) for image in (a, b)]
    fixed_point = np.ascontiguousarray(
        matcher.compute(wide[0], wide[1])[:, left : left + a.shape[1]]
    )
    return np.asarray(cv2.medianBlur(fixed_point, 5), np.float32) / np.float32(
        cv2.STEREO_MATCHER_DISP_SCALE
    )


def _filled(parallax: Float32Array, is_known: MaskArray) -> Float32Array:
    """What is not known as on its left or right, whichever lies farther away: occlusion hides what is behind."""
    height, width = parallax.shape
    columns = np.arange(width)
    before = np.maximum.accumulate(np.where(is_known, columns, 0), axis=1)
    after = np.minimum.accumulate(np.where(is_known, columns, width - 1)[:, ::-1], axis=1)[:, ::-1]
    rows = np.arange(height)[:, None]
    filled = np.where(is_known, parallax, np.float32(0.0))
    return np.minimum(filled[rows, before], filled[rows, after])


def _with_light_of(image: ImageArray, other: ImageArray, is_seen: ImageArray) -> ImageArray:
    """The image with the mean and the contrast of the other: semi-global matching compares grey levels.

    They are compared within is_seen, (H, W) 1. Of a wide pair that still takes in black where only something tall would
    be seen by the second view. To leave it out sharpens the match, also of foods that were pushed between photographs.
    """
    compared = is_seen if is_seen.any() else None
    mean, contrast = (float(part[0, 0]) for part in cv2.meanStdDev(image, mask=compared))
    mean_other, contrast_other = (
        float(part[0, 0]) for part in cv2.meanStdDev(other, mask=compared)
    )
    gain = contrast_other / contrast if contrast > 0 else 1.0
    return np.asarray(cv2.addWeighted(image, gain, image, 0.0, mean_other - gain * mean), np.uint8)


def _settle(
    first: ImageArray, second: ImageArray, start: Float32Array, level: int, left_px: int
) -> _Settled:
    """_settle_band on bands of rows: a band stays in the cache, the whole does not.

    second: with all its columns; first and start may begin at its column left_px.
    """
    height, width = first.shape
    parallax, sd = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    is_good = np.empty((height, width), np.bool_)
    # what a row's windows, and the windows that they rest on, reach
    halo = (WINDOW_PX // 2) * (STEPS + 1)
    for top in range(0, height, BAND_ROWS):
        low, high = max(0, top - halo), min(height, top + BAND_ROWS + halo)
        band = _settle_band(first[low:high], second[low:high], start[low:high], level, left_px)
        inner, here = (
            slice(top - low, top - low + BAND_ROWS),
            slice(top, min(height, top + BAND_ROWS)),
        )
        inner = slice(inner.start, inner.start + here.stop - here.start)
        parallax[here], sd[here], is_good[here] = (
            band.parallax[inner],
            band.sd[inner],
            band.is_good[inner],
        )
    return _Settled(parallax, sd, is_good)


def _settle_band(
    first: ImageArray, second: ImageArray, start: Float32Array, level: int, left_px: int
) -> _Settled:
    """Parallax that makes each window of the second image most like the first's, from where it starts.

    Gauss-Newton on the normalised cross correlation: the second image's window, moved, is regressed on the first's grey
    levels and their slope along the row. The ratio of the two coefficients is what is left to move (inverse
    compositional: Baker and Matthews, 2004); gain and offset drop out. Unlike the parabola through three correlations
    it prefers no whole pixels.
    """
    a = first.astype(np.float32)
    slope = np.asarray(cv2.Sobel(a, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), np.float32)
    mean_a, mean_slope = _box(a), _box(slope)
    aa = _box(a * a) - mean_a * mean_a
    ag = _box(a * slope) - mean_a * mean_slope
    gg = _box(slope * slope) - mean_slope * mean_slope
    determinant = np.maximum(aa * gg - ag * ag, np.float32(1e-3))
    parallax = start
    columns = np.arange(left_px, left_px + first.shape[1], dtype=np.float32)
    seen: Float32Array
    for _ in range(STEPS):
        seen = np.asarray(_sample(second, columns - parallax, cv2.INTER_CUBIC), np.float32)
        mean_seen = _box(seen)
        sa = _box(seen * a) - mean_seen * mean_a
        sg = _box(seen * slope) - mean_seen * mean_slope
        gain = sa * gg - sg * ag
        shift = (sg * aa - sa * ag) / np.maximum(gain, determinant * np.float32(0.1))
        # A window moves with its pixels' own parallax: without the median their noise would grow from step to step.
        parallax = cv2.medianBlur(parallax + np.clip(shift, np.float32(-1.0), np.float32(1.0)), 5)
    variance = np.maximum(_box(seen * seen) - mean_seen * mean_seen, np.float32(1e-3))
    gain /= determinant
    explained = gain * sa + np.clip(shift, -1.0, 1.0) * gain * sg
    unexplained = np.maximum(variance - explained, np.float32(0.0))
    # Of the shift: noise over gain, slope that the grey levels do not explain, and the number of independent pixels.
    information = np.maximum(determinant / np.maximum(aa, np.float32(1e-3)), np.float32(1e-3))
    count = np.float32(INDEPENDENT_SHARE * WINDOW_PX**2)
    sd = np.sqrt((unexplained + np.float32(0.1)) / (information * count)) / np.maximum(
        gain, np.float32(0.1)
    )
    where = columns - parallax
    is_good = (
        (sa > np.float32(MIN_CORRELATION) * np.sqrt(aa * variance))
        & (
            aa > np.float32((MIN_TEXTURE / level) ** 2)
        )  # averaging over level^2 pixels divides the noise by level
        & (sd < np.float32(MAX_SD_PX))
        & (np.abs(parallax - start) < np.float32(MAX_MOVE_PX))
        & (where >= 0)
        & (where <= second.shape[1] - 1)
    )
    return _Settled(parallax, sd, is_good)


def _level_size(image: ImageArray, level: int) -> tuple[int, int]:
    """(width, height) of an image on a level."""
    return max(1, round(image.shape[1] / level)), max(1, round(image.shape[0] / level))


def _resized(image: np.ndarray, size: tuple[int, int], interpolation: int) -> np.ndarray:
    """(height, width) image; size: (width, height)."""
    if size == (image.shape[1], image.shape[0]):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=interpolation))


def _sample(image: np.ndarray, columns: Float32Array, interpolation: int) -> np.ndarray:
    """(H, W) image at (columns, own row); its border's value outside."""
    rows = np.broadcast_to(np.arange(columns.shape[0], dtype=np.float32)[:, None], columns.shape)
    return np.asarray(
        cv2.remap(
            image,
            columns,
            np.ascontiguousarray(rows),
            interpolation,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )


def _box(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, (WINDOW_PX, WINDOW_PX)), np.float32)


def _without_speckles(parallax: Float32Array) -> Float32Array:
    """NaN for islands of fewer than SPECKLE_PX pixels whose parallax steps away from all around them."""
    low = float(np.nanmin(parallax)) if np.isfinite(parallax).any() else 0.0
    scaled = np.where(np.isfinite(parallax), (parallax - low) * 16 + 16, 0.0).astype(np.int16)
    cv2.filterSpeckles(scaled, 0, SPECKLE_PX, SPECKLE_STEP_PX * 16)
    return np.where(scaled > 0, parallax, np.float32(np.nan)).astype(np.float32)
