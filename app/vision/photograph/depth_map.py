"""A depth map beside a photograph: 16 bit PNG or TIFF of float32, read, checked, and its noise told from itself.

Bytes and the depth camera's intrinsics -> DepthMap in mm along the optical axis, NaN where nothing was measured. The
depth camera is a pinhole in the photograph's pose.
"""

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.model import DepthMap, Float32Array, MaskArray
from app.vision.photograph.depth_camera import DepthCamera, size_mismatch

DEPTH_MM = (50.0, 20_000.0)  # nearer or farther, a number is none of a meal's depth
MIN_MEASURED_SHARE = 0.1
BLOCK_PX = 16  # in which a surface is nearly a plane in depth
MIN_NOISE_MM = 0.3  # of any depth, rounding and interpolation
AREA_LIMITS_PX = (1.0, 64.0)  # of the map, over which errors are one
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
MAGIC = (PNG_MAGIC, b"II*\x00", b"MM\x00*")
HIGHEST_LEVEL = 2  # ARKit's: 0 low, 1 medium, 2 high
LEAST_CONFIDENCE = 128  # of 0 to 255, as ARCore's


def read_depth(
    data: bytes, camera: DepthCamera, confidence: bytes | None = None
) -> DepthMap | Failure:
    """The depth map, without what its confidence map calls unsure. confidence: see read_confidence.

    Failures: depth_unreadable, depth_mismatch, depth_empty.
    """
    if not data.startswith(MAGIC):
        return _unreadable("it is neither a PNG nor a TIFF file")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if (
        pixels is None
        or pixels.ndim != 2
        or (data.startswith(PNG_MAGIC) and b"IEND" not in data[-12:])
    ):
        return _unreadable("it cannot be decoded as one channel")
    if pixels.dtype not in (np.uint16, np.float32):
        return _unreadable("a PNG needs 16 bits, a TIFF 32 bit floating point numbers in mm")
    mismatch = size_mismatch(pixels.shape[1], pixels.shape[0], camera)
    if mismatch is not None:
        return mismatch
    unit_mm = camera.unit_mm if pixels.dtype == np.uint16 else 1.0
    with np.errstate(invalid="ignore", over="ignore"):
        depth_mm = pixels.astype(np.float32) * np.float32(unit_mm)
    if confidence is not None:
        is_sure = read_confidence(confidence, camera)
        if isinstance(is_sure, Failure):
            return is_sure
        depth_mm[~is_sure] = np.nan
    measured = keep_measured(depth_mm)
    if isinstance(measured, Failure):
        return measured
    sd_share, area_px = measure_noise(measured)
    return DepthMap(measured, camera.fx, camera.fy, camera.cx, camera.cy, sd_share, area_px)


def keep_measured(depth_mm: Float32Array) -> Float32Array | Failure:
    """(h, w) with NaN outside DEPTH_MM. Failure "depth_empty" of a map that has little else."""
    with np.errstate(invalid="ignore"):
        is_measured = (depth_mm > DEPTH_MM[0]) & (depth_mm < DEPTH_MM[1])
    if np.mean(is_measured) < MIN_MEASURED_SHARE:
        return Failure(
            "depth_empty",
            f"Only {np.mean(is_measured):.0%} of the depth map lie between {DEPTH_MM[0]:g} and {DEPTH_MM[1]:g} mm.",
            "Check the unit; 0 stands for no measurement, and what a confidence map calls unsure counts as none.",
        )
    return np.where(is_measured, depth_mm, np.float32(np.nan)).astype(np.float32)


def read_confidence(data: bytes, camera: DepthCamera) -> MaskArray | Failure:
    """(h, w) where the confidence map, an 8 bit PNG, trusts the depth. Failures: depth_unreadable, depth_mismatch.

    A map that has no value above 2 is of ARKit's levels (ARConfidenceLevel): 0, low, is not trusted. Any other is of
    0 to 255, as ARCore's, and trusted from 128 on.
    """
    pixels = None
    if data.startswith(PNG_MAGIC) and b"IEND" in data[-12:]:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.ndim != 2 or pixels.dtype != np.uint8:
        return Failure(
            "depth_unreadable",
            "The confidence map cannot be read: it is no whole PNG of 8 bits and one channel.",
            "Send an 8 bit PNG of the depth map's size.",
        )
    mismatch = size_mismatch(pixels.shape[1], pixels.shape[0], camera)
    if mismatch is not None:
        return mismatch
    least = 1 if pixels.max() <= HIGHEST_LEVEL else LEAST_CONFIDENCE
    return pixels >= least


def measure_noise(depth_mm: Float32Array) -> tuple[float, float]:
    """Noise per depth, and the area over which its errors are one, px of the map; from blocks that are nearly planes.

    Residuals of a plane in inverse depth, in which a plane is one; the median over blocks leaves out edges.
    """
    height, width = depth_mm.shape
    y, x = np.mgrid[0:BLOCK_PX, 0:BLOCK_PX].reshape(2, -1).astype(np.float64) / BLOCK_PX
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    project = np.eye(len(x)) - design @ np.linalg.pinv(design)
    shares, areas = [], []
    for top in range(0, height - BLOCK_PX + 1, BLOCK_PX):
        for left in range(0, width - BLOCK_PX + 1, BLOCK_PX):
            block = depth_mm[top : top + BLOCK_PX, left : left + BLOCK_PX].astype(np.float64)
            if not np.isfinite(block).all():
                continue
            off = (project @ (1.0 / block.ravel())).reshape(block.shape) * np.median(block)
            variance = float(np.mean(off**2))
            shares.append(np.sqrt(variance))
            near = [float(np.mean(off[:, :-1] * off[:, 1:])), float(np.mean(off[:-1] * off[1:]))]
            areas.append(np.mean(near) / max(variance, 1e-12))
    if not shares:
        return 0.02, AREA_LIMITS_PX[1]
    calm = np.array(shares) <= np.median(shares)
    correlation = float(np.clip(np.median(np.array(areas)[calm]), 0.0, 0.95))
    # Of noise under a Gaussian: neighbours' correlation is exp(-1 / (4 s^2)), the sum of all 4 pi s^2.
    area = 1.0 if correlation <= 0.05 else 4 * np.pi / (-4 * np.log(correlation))
    return float(np.median(np.array(shares)[calm])), float(np.clip(area, *AREA_LIMITS_PX))


def _unreadable(reason: str) -> Failure:
    return Failure(
        "depth_unreadable",
        f"The depth map cannot be read: {reason}.",
        "Send a 16 bit PNG (0: not measured) or a TIFF of float32 in mm.",
    )
