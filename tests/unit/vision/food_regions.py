"""Regions with known truth: shapes, and surfaces that are nobody's food."""

import cv2
import numpy as np

from app.vision.looks.vcm_region import Region

SIDE = 160
LOPSIDED = np.array([[20.0, 30], [90, 15], [140, 60], [100, 80], [120, 140], [40, 120]])  # px, of SIDE


def ellipse_mask(across: int = 60, down: int = 40, side: int = SIDE) -> np.ndarray:
    mask = np.zeros((side, side), np.uint8)
    cv2.ellipse(mask, (side // 2, side // 2), (across, down), 0.0, 0.0, 360.0, 1, -1)
    return mask > 0


def lopsided_mask(side: int = SIDE) -> np.ndarray:
    """No symmetry at all: none of Hu's moments is 0."""
    mask = np.zeros((side, side), np.uint8)
    cv2.fillPoly(mask, [np.round(LOPSIDED * side / SIDE).astype(np.int32)], 1)
    return mask > 0


def speckled(side: int = SIDE, grain_px: float = 1.5, seed: int = 3) -> np.ndarray:
    """(side, side, 3) uint8: smooth random colours."""
    noise = np.random.default_rng(seed).standard_normal((side, side, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), grain_px, borderType=cv2.BORDER_REFLECT)
    return np.clip(130.0 + 45.0 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def speckled_region() -> Region:
    return Region(speckled(), lopsided_mask())


def plain(colour_bgr: tuple[int, int, int], side: int = SIDE) -> np.ndarray:
    return np.full((side, side, 3), colour_bgr, np.uint8)
