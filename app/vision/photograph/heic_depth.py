"""Decode the depth map inside a HEIC file, whose levels photos/heic_depth.py explains. bytes -> DepthMap.

The map's pixels are the photograph's, reduced. A relative map holds any affine function of inverse depth; the table
under the marker makes it metric later (views/aligned_depth.py).
"""

import io
from collections.abc import Callable

import cv2
import numpy as np
from PIL import Image
from pillow_heif import HeifImageFile

from app.core.errors import Failure
from app.vision.model import DepthMap
from app.vision.photograph.depth_camera import MAX_SIDE_PX, MIN_SIDE_PX
from app.vision.photograph.depth_map import AREA_LIMITS_PX, keep_measured, measure_noise
from app.vision.photograph.photo import DECODE_ERRORS, TRANSPOSED

MM_PER_M = 1000.0
OPEN: Callable[[io.BytesIO], Image.Image] = HeifImageFile
RELATIVE_MM = (500.0, 1000.0)
# phones enlarge and smooth what their sensors measure, after which neighbours err together
LONG_SIDE_PX = 256


def decode_heic_depth(
    data: bytes,
    *,
    size: tuple[int, int],
    orientation: int,
    level_range: tuple[float, float],
    value_range: tuple[float, float],
    is_inverse: bool,
    is_metric: bool,
) -> DepthMap | Failure:
    """The map in the photograph's upright pixels, reduced. size: width, height of what is to be decoded.

    Failures: depth_unreadable, depth_empty.
    """
    if min(size) < MIN_SIDE_PX or max(size) > MAX_SIDE_PX:
        return _unreadable(f"it has {size[0]} x {size[1]} px")
    try:
        maps = OPEN(io.BytesIO(data)).info["depth_images"]
        if len(maps) != 1 or maps[0].size != size or maps[0].mode != "L":
            return _unreadable("it is no picture of 8 bits and one channel")
        levels = np.array(maps[0], np.float32)[:, : size[0]]
    except DECODE_ERRORS:
        return _unreadable("its pixels cannot be decoded")
    if levels.shape != size[::-1]:
        return _unreadable("it is no picture of 8 bits and one channel")
    turn = TRANSPOSED.get(orientation)
    levels = levels if turn is None else np.ascontiguousarray(turn(levels), np.float32)
    step = (value_range[1] - value_range[0]) / (level_range[1] - level_range[0])
    values = np.float32(value_range[0]) + np.float32(step) * (levels - np.float32(level_range[0]))
    with np.errstate(divide="ignore", invalid="ignore"):
        per_m = values if is_inverse else np.where(values > 0, 1 / values, np.float32(np.nan))
    numbers = per_m[np.isfinite(per_m)]
    low, high = float(numbers.min(initial=np.inf)), float(numbers.max(initial=-np.inf))
    if not low < high:
        return _unreadable("it is flat")
    step_per_m = step if is_inverse else step * float(np.median(numbers)) ** 2
    factor = max(1, max(size) // LONG_SIDE_PX)
    per_m = cv2.resize(
        per_m, (per_m.shape[1] // factor, per_m.shape[0] // factor), interpolation=cv2.INTER_AREA
    )
    # A relative map is brought into RELATIVE_MM: only its differences tell anything.
    scale = (
        (1 / RELATIVE_MM[0] - 1 / RELATIVE_MM[1]) / (high - low) if not is_metric else 1 / MM_PER_M
    )
    offset = 1 / RELATIVE_MM[1] - low * scale if not is_metric else 0.0
    per_mm = per_m * np.float32(scale) + np.float32(offset)
    measured = keep_measured(
        np.where(per_mm > 0, 1 / np.maximum(per_mm, np.float32(1e-9)), np.float32(np.nan))
    )
    if isinstance(measured, Failure):
        return measured
    sd_share, area_px = measure_noise(measured)
    # Rounding to levels: of slow slopes it is one error over many pixels, and in places no noise at all.
    rounding = step_per_m * scale * float(np.nanmedian(measured)) / np.sqrt(12.0)
    if rounding > sd_share:
        area_px = AREA_LIMITS_PX[1]
    height, width = measured.shape
    return DepthMap(
        measured,
        float(width),
        float(width),
        (width - 1) / 2,
        (height - 1) / 2,
        float(np.hypot(sd_share, rounding)),
        area_px,
        is_aligned=True,
        is_relative=not is_metric,
    )


def _unreadable(reason: str) -> Failure:
    return Failure(
        "depth_unreadable",
        f"The depth map in the HEIC file cannot be used: {reason}.",
        "Send the file as the camera saved it.",
    )
