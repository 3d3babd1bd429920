"""VCM of shape: the outline's measures, its radial spectrum, and where gradients of which direction lie."""

import cv2
import numpy as np

from app.vision.model import Float64Array, ImageArray, MaskArray

RADII = 64  # of the outline, all around
HARMONICS = 12
GRADIENT_SIDE_PX = 64
CELLS, DIRECTIONS = 4, 8
HU_MOMENTS = 4  # the others change their sign with a tenth of a pixel of outline where a food is nearly symmetric
LEAST_MOMENT = 1e-6  # of a drawn disc; less is the pixels' doing


def outline_measures(mask: MaskArray) -> Float64Array:
    """(8,) elongation, rectangularity, circularity, solidity; Hu's first four moments.

    Of the outermost outline, through its pixels' centres: holes do not count. Elongation: the shorter over the longer
    side of the smallest rectangle around it.

    Zhang and Lu, "Review of shape representation and description techniques", Pattern Recognition 37(1), 2004; Hu,
    "Visual pattern recognition by moment invariants", IRE Trans. IT 8(2), 1962, as -log10 h.
    """
    outline = _outline(mask)
    area, length = float(cv2.contourArea(outline)), float(cv2.arcLength(outline, closed=True))
    _, (across, down), _ = cv2.minAreaRect(outline)
    hull = float(cv2.contourArea(cv2.convexHull(outline)))
    moments = cv2.HuMoments(cv2.moments(outline)).ravel()[:HU_MOMENTS]  # sums of squares
    return np.concatenate(
        [
            [
                min(across, down) / max(across, down, 1.0),
                area / (across * down + 1.0),
                4.0 * np.pi * area / (length * length + 1.0),
                area / (hull + 1.0),
            ],
            -np.log10(np.maximum(moments, 0.0) + LEAST_MOMENT),
        ]
    )


def radial_descriptors(mask: MaskArray) -> Float64Array:
    """(12,) log sizes of the first harmonics of the distance from centroid to outline, over the mean distance.

    Zhang and Lu, "A comparative study of Fourier descriptors for shape representation and retrieval", ACCV 2002: the
    centroid distance, here at equal steps of direction in place of length; sizes alone do not turn with the food.
    """
    points = _outline(mask).reshape(-1, 2).astype(np.float64)
    from_middle = points - points.mean(axis=0)
    angles, radii = np.arctan2(from_middle[:, 1], from_middle[:, 0]), np.hypot(*from_middle.T)
    order = np.argsort(angles, kind="stable")
    around = np.linspace(-np.pi, np.pi, RADII, endpoint=False)
    spectrum = np.abs(
        np.fft.rfft(np.interp(around, angles[order], radii[order], period=2.0 * np.pi))
    )
    return np.log(spectrum[1 : HARMONICS + 1] / max(float(spectrum[0]), 1e-9) + 1e-4)


def oriented_gradients(grey: ImageArray, mask: MaskArray) -> Float64Array:
    """(128,) histograms of oriented gradients over the food's box, 4 x 4 cells of 8 directions, without sign.

    Dalal and Triggs, "Histograms of oriented gradients for human detection", CVPR 2005, normalised over the whole box.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = grey[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    small = cv2.resize(box, (GRADIENT_SIDE_PX, GRADIENT_SIDE_PX)).astype(np.float32)
    across, down = cv2.Sobel(small, cv2.CV_32F, 1, 0), cv2.Sobel(small, cv2.CV_32F, 0, 1)
    size, angle = np.hypot(across, down), np.arctan2(down, across) % np.pi
    direction = (angle / np.pi * DIRECTIONS).astype(int) % DIRECTIONS
    cell = np.arange(GRADIENT_SIDE_PX) * CELLS // GRADIENT_SIDE_PX
    place = (cell[:, None] * CELLS + cell[None, :]) * DIRECTIONS + direction
    counts = np.bincount(place.ravel(), weights=size.ravel(), minlength=CELLS * CELLS * DIRECTIONS)
    return np.asarray(np.sqrt(counts / (counts.sum() + 1e-6)), np.float64)


def _outline(mask: MaskArray) -> np.ndarray:
    """(n, 1, 2) the outermost outline of the largest piece, px."""
    contours = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return np.asarray(max(contours, key=cv2.contourArea)).reshape(-1, 1, 2)
