"""VCM of colour: histograms, statistics, and how colour runs from the outline to the middle."""

import cv2
import numpy as np

from app.vision.looks.vcm_region import Region
from app.vision.model import Float32Array, Float64Array, MaskArray

LAB_RANGES = ((0.0, 100.0, 16), (-40.0, 70.0, 22), (-20.0, 90.0, 22))  # of foods: low, high, bins
HUE_BINS, SATURATION_BINS = 18, 8
RINGS = ((0.0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1.0))  # of the greatest distance from the outline
PERCENTILES = (5, 25, 50, 75, 95)


def lab_histograms(lab: Float32Array) -> Float64Array:
    """(60,) histograms of L*, a* and b*, 16, 22 and 22 bins. lab: (n, 3) pixels.

    Swain and Ballard, "Color indexing", IJCV 7(1), 1991.
    """
    return np.concatenate(
        [_histogram(lab[:, i], low, high, bins) for i, (low, high, bins) in enumerate(LAB_RANGES)]
    )


def hue_saturation(region: Region, inner: MaskArray) -> Float64Array:
    """(26,) hue, each pixel with the weight of its saturation, since grey has no hue; and saturation (HSV).

    Van de Weijer and Schmid, "Coloring local feature extraction", ECCV 2006.
    """
    hsv = cv2.cvtColor(region.pixels_bgr, cv2.COLOR_BGR2HSV)[inner].astype(np.float64)
    hue = _histogram(hsv[:, 0], 0.0, 180.0, HUE_BINS, weights=hsv[:, 1])
    return np.concatenate([hue, _histogram(hsv[:, 1], 0.0, 256.0, SATURATION_BINS)])


def lab_rings(lab: Float32Array, mask: MaskArray) -> Float64Array:
    """(18,) mean and standard deviation of L*, a*, b* in three rings by the distance from the outline.

    Where colour lies, whichever way the food is turned: the crumb of a bun, the seeds of a kiwifruit. After Stricker
    and Dimai, "Color indexing with weak spatial constraints", SPIE 2670, 1996, with rings for their five regions.
    """
    framed = np.pad(mask.astype(np.uint8), 1)  # the photograph's edge is an outline too
    depth = cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1]
    share = depth / max(float(depth.max()), 1.0)
    measures = []
    for low, high in RINGS:
        pixels = lab[mask & (share > low) & (share <= high)]
        if len(pixels) == 0:
            pixels = lab[mask]
        measures += [pixels.mean(axis=0), pixels.std(axis=0)]
    return np.concatenate(measures).astype(np.float64)


def lab_moments(lab: Float32Array) -> Float64Array:
    """(24,) mean, standard deviation, five percentiles a channel, and skewness of L*, a*, b*. lab: (n, 3) pixels.

    Stricker and Orengo, "Similarity of color images", SPIE 2420, 1995.
    """
    mean, sd = lab.mean(axis=0, dtype=np.float64), lab.std(axis=0, dtype=np.float64)
    apart = lab - mean
    skewness = (apart * apart * apart).mean(axis=0) / (sd**3 + 1e-6)
    percentiles = np.concatenate(
        [np.percentile(channel, PERCENTILES) for channel in np.ascontiguousarray(lab.T)]
    )
    return np.concatenate([mean, sd, percentiles, skewness]).astype(np.float64)


def _histogram(
    values: np.ndarray, low: float, high: float, bins: int, weights: np.ndarray | None = None
) -> Float64Array:
    """Square roots of the bins' shares; what lies outside counts to the outermost bins; zeros without weight."""
    inside = np.clip(values, low, np.nextafter(high, low))
    counts = np.histogram(inside, bins, (low, high), weights=weights)[0].astype(np.float64)
    return np.sqrt(counts / max(float(counts.sum()), 1e-9))
