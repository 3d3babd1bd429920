"""Dense disparity by normalised cross correlation (paper, section IV.D), coarse to fine, sub-pixel, checked both ways.

Two images whose rows are epipolar lines -> parallax of every pixel, NaN where unmatched. The pair comes sheared by the
support's plane (rectification.py), so that a window on the support, the most slanted surface of a meal, needs no slant
of its own; on finer levels each pixel of a window moves by the parallax found before, so that a window follows any
smooth surface. Where a fine window shows nothing but noise, the coarser level's larger one stands in.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float32Array, ImageArray, MaskArray

LEVELS = (4, 2, 1)  # reductions; the search over the whole range happens on the first
WINDOW_PX = 9  # on each level: 36, 18 and 9 px of the working image
MIN_CORRELATION = 0.6
MIN_TEXTURE = 1.0  # grey levels, standard deviation in a window: below, it is the sensor's noise that is correlated
MAX_CHECK_DIFFERENCE_PX = 1.0  # between the parallax from either view
SPECKLE_PX = 100  # smaller islands of parallax that hang together with nothing are mismatches
SPECKLE_STEP_PX = 2


@dataclass(frozen=True, slots=True)
class DisparityMap:
    """parallax_px: (H, W) of the first image, NaN where unmatched. reach_px: (H, W) half the window of each.

    Within that reach of an object's outline a parallax may be that of the other side.
    """

    parallax_px: Float32Array
    reach_px: Float32Array


def match_dense(
    first_bgr: ImageArray, second_bgr: ImageArray, range_px: tuple[float, float], is_seen: MaskArray | None = None
) -> DisparityMap:
    """Parallax x_first - x_second by NCC in both directions; kept where both agree.

    first_bgr, second_bgr: (H, W, 3). range_px: least and greatest parallax. is_seen: (H, W) where to keep any.
    """
    first, second = _grey(first_bgr), _grey(second_bgr)
    there = _match_one_way(first, second, range_px)
    # In the second image's own grid the same point moves the other way.
    back = _match_one_way(second, first, (-range_px[1], -range_px[0]))
    height, width = first.shape
    parallax = np.full((height, width), np.nan, np.float32)
    reach = np.zeros((height, width), np.float32)
    for level, forth, reverse in zip(LEVELS, there, back, strict=True):  # a finer level overrides a coarser one
        found = _checked(forth, reverse, level)
        kept = _resized(found * np.float32(width / found.shape[1]), (width, height), cv2.INTER_LINEAR)
        is_kept = np.isfinite(kept)
        parallax[is_kept] = kept[is_kept]
        reach[is_kept] = level * WINDOW_PX / 2
    if is_seen is not None:  # windows that reach over the border see its edge, not the scene
        side = LEVELS[0] * WINDOW_PX + 1
        kernel = np.ones((side, side), np.uint8)
        parallax[cv2.erode(is_seen.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0) == 0] = (
            np.nan
        )
    return DisparityMap(_without_speckles(parallax), reach)


def _grey(image_bgr: ImageArray) -> Float32Array:
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.float32)


def correlate(first: Float32Array, second: Float32Array) -> Float32Array:
    """(H, W) NCC of the windows around each pixel of two grey images; 0 where either window is constant."""
    return _correlate(first, _window_moments(first), second)


@dataclass(frozen=True, slots=True)
class _Level:
    """One level's parallax (H, W), px of that level, its NCC, and the windows' standard deviation, grey levels."""

    parallax: Float32Array
    correlation: Float32Array
    texture: Float32Array


def _match_one_way(first: Float32Array, second: Float32Array, range_px: tuple[float, float]) -> list[_Level]:
    """Parallax of each pixel of `first`, level by level, the finest last."""
    levels: list[_Level] = []
    for level in LEVELS:
        size = (max(1, round(first.shape[1] / level)), max(1, round(first.shape[0] / level)))
        a, b = _resized(first, size, cv2.INTER_AREA), _resized(second, size, cv2.INTER_AREA)
        if not levels:
            low, high = int(np.floor(range_px[0] / level)), int(np.ceil(range_px[1] / level))
            start = _sweep(a, b, low, high)
            parallax, correlation = _subpixel(a, _window_moments(a), b, start)
        else:
            parallax, correlation = _refine(a, b, levels[-1].parallax, size)
        mean, mean_square = _window_moments(a)
        texture = np.sqrt(np.maximum(mean_square - mean * mean, 0.0))
        levels.append(_Level(parallax, correlation, texture))
    return levels


def _checked(forth: _Level, reverse: _Level, level: int) -> Float32Array:
    """(H, W) parallax of one level, NaN where weak, featureless, or not confirmed from the other view."""
    columns = _columns(forth.parallax) - forth.parallax
    returned = _sample(reverse.parallax, columns)
    is_good = (
        (np.abs(forth.parallax + returned) <= MAX_CHECK_DIFFERENCE_PX)
        & (forth.correlation >= MIN_CORRELATION)
        & (forth.texture >= MIN_TEXTURE / level)  # averaging over level^2 pixels divides the noise by level
        & (columns >= 0)
        & (columns <= forth.parallax.shape[1] - 1)
    )
    return np.where(is_good, forth.parallax, np.float32(np.nan)).astype(np.float32)


def _sweep(first: Float32Array, second: Float32Array, low: int, high: int) -> Float32Array:
    """The best whole-pixel parallax between low and high."""
    moments = _window_moments(first)
    best = np.full_like(first, -2.0)
    parallax = np.zeros_like(first)
    width = first.shape[1]
    for shift in range(low, high + 1):
        moved = np.zeros_like(second)
        if shift >= 0 and shift < width:
            moved[:, shift:] = second[:, : width - shift]
        elif -width < shift < 0:
            moved[:, :shift] = second[:, -shift:]
        score = _correlate(first, moments, moved)
        better = score > best
        best[better] = score[better]
        parallax[better] = shift
    return np.asarray(cv2.medianBlur(parallax, 5), np.float32)


def _refine(
    first: Float32Array, second: Float32Array, coarse: Float32Array, size: tuple[int, int]
) -> tuple[Float32Array, Float32Array]:
    """Parallax on the next finer level: the coarse one and its neighbours', each give or take a pixel."""
    scale = size[0] / coarse.shape[1]
    kernel = np.ones((3, 3), np.uint8)
    candidates = [coarse, cv2.dilate(coarse, kernel), cv2.erode(coarse, kernel)]
    moments = _window_moments(first)
    best = np.full_like(first, -2.0)
    parallax = np.zeros_like(first)
    for candidate in candidates:
        start = cv2.resize(candidate, size, interpolation=cv2.INTER_LINEAR) * np.float32(scale)
        for offset in (-1.0, 0.0, 1.0):
            trial = start + np.float32(offset)
            score = _correlate(first, moments, _sample(second, _columns(trial) - trial))
            better = score > best
            best[better] = score[better]
            parallax[better] = trial[better]
    parallax = cv2.medianBlur(parallax, 5).astype(np.float32)
    return _subpixel(first, moments, second, parallax)


def _subpixel(
    first: Float32Array,
    moments: tuple[Float32Array, Float32Array],
    second: Float32Array,
    parallax: Float32Array,
) -> tuple[Float32Array, Float32Array]:
    """The top of the parabola through the NCC at a pixel less, here, and a pixel more."""
    less, here, more = (
        _correlate(first, moments, _sample(second, _columns(parallax) - (parallax + np.float32(step))))
        for step in (-1, 0, 1)
    )
    curvature = less - 2 * here + more
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(curvature < 0, 0.5 * (less - more) / curvature, np.sign(more - less))
    step = np.clip(np.nan_to_num(step), -1.0, 1.0).astype(np.float32)
    return parallax + step, np.maximum(here, np.maximum(less, more))


def _resized(image: Float32Array, size: tuple[int, int], interpolation: int) -> Float32Array:
    """(height, width) image; size: (width, height)."""
    if size == (image.shape[1], image.shape[0]):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), np.float32)


def _columns(like: Float32Array) -> Float32Array:
    return np.broadcast_to(np.arange(like.shape[1], dtype=np.float32), like.shape)


def _sample(image: Float32Array, columns: Float32Array) -> Float32Array:
    """(H, W) image at (columns, own row), linear; zero outside."""
    rows = np.broadcast_to(np.arange(columns.shape[0], dtype=np.float32)[:, None], columns.shape)
    return np.asarray(
        cv2.remap(image, columns.astype(np.float32), np.ascontiguousarray(rows), cv2.INTER_LINEAR), np.float32
    )


def _box(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, (WINDOW_PX, WINDOW_PX)), np.float32)


def _window_moments(image: Float32Array) -> tuple[Float32Array, Float32Array]:
    return _box(image), _box(image * image)


def _correlate(first: Float32Array, moments: tuple[Float32Array, Float32Array], second: Float32Array) -> Float32Array:
    mean_second, square_second = _window_moments(second)
    mean_first, square_first = moments
    covariance = _box(first * second) - mean_first * mean_second
    variance = (square_first - mean_first * mean_first) * (square_second - mean_second * mean_second)
    # A variance below a thousandth of a grey level squared is float32's rounding.
    return np.asarray(np.where(variance > 1e-3, covariance / np.sqrt(np.maximum(variance, 1e-3)), 0.0), np.float32)


def _without_speckles(parallax: Float32Array) -> Float32Array:
    """NaN for islands of fewer than SPECKLE_PX pixels whose parallax steps away from all around them."""
    low = float(np.nanmin(parallax)) if np.isfinite(parallax).any() else 0.0
    scaled = np.where(np.isfinite(parallax), (parallax - low) * 16 + 16, 0.0).astype(np.int16)
    cv2.filterSpeckles(scaled, 0, SPECKLE_PX, SPECKLE_STEP_PX * 16)
    return np.where(scaled > 0, parallax, np.float32(np.nan)).astype(np.float32)
