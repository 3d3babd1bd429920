"""Where small patches of one picture lie in the other, to a twentieth of a pixel.

Two grey pictures, points of the first and first guesses in the second -> points in the second; NaN where the patches
do not agree. Light may differ in level and contrast, the surface may be slanted.
"""

import cv2
import numpy as np

from app.vision.geometry.pictures import sampled
from app.vision.model import Float32Array, Float64Array, ImageArray

HALF_PATCH_PX = 7
# the patch's rim counts little: there the surface is no longer the plane that is fitted
WINDOW_SD_PX = 4.0
STEPS = 6
# prior of stretch and shear beyond what the guess has: a surface tilted by some 30 degrees
WARP_SPREAD = 0.3
MIN_CORRELATION = 0.7
MAX_LAST_STEP_PX = 0.1  # not settled by then: there is no optimum there
MAX_SD_PX = 0.2
MIN_NOISE = 1.0  # grey levels that sampling and compression leave


def align_patches(
    first: ImageArray,
    second: ImageArray,
    first_px: Float64Array,
    second_px: Float64Array,
    jacobians: Float64Array,
    max_move_px: float,
) -> Float64Array:
    """(n, 2) px in the second picture of patches around first_px, sought from second_px (n, 2).

    jacobians: (n, 2, 2) how the second picture's px change with the first's, by the guess. Inverse compositional
    Gauss-Newton over shift, stretch and shear, with gain and offset in closed form (Baker and Matthews, 2004). NaN
    where patches are unlike, hold too little texture, or moved by more than max_move_px.
    """
    if len(first_px) == 0:
        return np.empty((0, 2))
    axis = np.arange(-HALF_PATCH_PX, HALF_PATCH_PX + 1, dtype=np.float32)
    u, v = (part.ravel() for part in np.meshgrid(axis, axis))
    offsets = np.stack([u, v], axis=-1).astype(np.float64)
    weight = np.exp(-0.5 * (u * u + v * v) / WINDOW_SD_PX**2).astype(np.float32)
    template = _sample(first, first_px[:, None] + offsets)
    slope_x, slope_y = (
        _sample(first, first_px[:, None] + offsets + step)
        - _sample(first, first_px[:, None] + offsets - step)
        for step in np.diag([0.5, 0.5])
    )
    design = np.stack(
        [
            np.ones_like(template),
            template,
            slope_x,
            slope_y,
            slope_x * u,
            slope_x * v,
            slope_y * u,
            slope_y * v,
        ],
        axis=-1,
    )
    weighted = design * weight[:, None]
    normal = (np.swapaxes(weighted, 1, 2) @ design).astype(np.float64)
    # Stretch and shear get a prior that counts against a noise of one grey level; the rest a trace for the inverse.
    ridge = np.diag([1e-6, 1e-6, 1e-6, 1e-6, *[(MIN_NOISE / WARP_SPREAD) ** 2] * 4])
    inverse = np.linalg.inv(normal + ridge)
    warp = np.broadcast_to(np.eye(2), (len(first_px), 2, 2)).copy()
    shift = np.zeros((len(first_px), 2))
    last = np.full(len(first_px), np.inf)
    for _ in range(STEPS):
        seen = _sample(
            second,
            second_px[:, None]
            + (offsets @ np.swapaxes(warp, 1, 2) + shift[:, None]) @ jacobians.swapaxes(1, 2),
        )
        solved = (inverse @ (np.swapaxes(weighted, 1, 2) @ seen[..., None]))[..., 0]
        gain = np.where(np.abs(solved[:, 1]) > 1e-3, solved[:, 1], np.nan)[:, None]
        step = np.clip(np.nan_to_num(solved[:, 2:4] / gain), -1.5, 1.5)
        stretch = np.clip(np.nan_to_num(solved[:, 4:] / gain), -0.3, 0.3).reshape(-1, 2, 2)
        shift = shift - (warp @ step[..., None])[..., 0]
        warp = warp @ (np.eye(2) - stretch)
        last = np.linalg.norm(step, axis=1)
    noise, correlation = _residual(design, weight, seen, solved)
    sd = (
        np.maximum(noise, MIN_NOISE)
        * np.sqrt(np.maximum(inverse[:, 2, 2], inverse[:, 3, 3]))
        / np.abs(solved[:, 1])
    )
    is_good = (
        (solved[:, 1] > 0)
        & (correlation > MIN_CORRELATION)
        & (last < MAX_LAST_STEP_PX)
        & (sd < MAX_SD_PX)
        & (np.linalg.norm(shift, axis=1) < max_move_px)
    )
    aligned_px = second_px + (jacobians @ shift[..., None])[..., 0]
    aligned_px[~is_good] = np.nan
    return aligned_px


def _residual(
    design: Float32Array, weight: Float32Array, seen: Float32Array, solved: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """(n,) weighted standard deviation of what is left, grey levels, and (n,) the share explained as a correlation."""
    left = seen - (design @ solved[..., None].astype(np.float32))[..., 0]
    share = weight / weight.sum()
    mean = (seen * share).sum(axis=1)
    variance = ((seen - mean[:, None]) ** 2 * share).sum(axis=1)
    unexplained = (left**2 * share).sum(axis=1)
    return np.sqrt(unexplained), np.sqrt(
        np.clip(1.0 - unexplained / np.maximum(variance, 1e-3), 0.0, 1.0)
    )


def _sample(image: ImageArray, places_px: Float64Array) -> Float32Array:
    """(n, k) grey levels at (n, k, 2) px, cubic; the border's beyond it."""
    # Not float32 pictures: converting the whole would take longer than all samples.
    return np.asarray(sampled(image, places_px, cv2.INTER_CUBIC, beyond=None), np.float32)
