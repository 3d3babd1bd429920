"""Where foods may be in a single photograph in which nobody has pointed at one: a few boxes to look into.

Pixels of like colour that hang together and do not reach the photograph's edge, at several numbers of colours, as in
Uijlings et al., "Selective search for object recognition", IJCV 104(2), 2013. Which of them holds a food is for the
index to say. A stereo pair has depth to go by (segmentation.py) and does not need this.
"""

import cv2
import numpy as np

from app.vision.geometry.pictures import lab_of
from app.vision.looks.vcm_region import Box
from app.vision.model import ImageArray

LONG_SIDE_PX = 200
SMOOTHING_SD_PX = 1.5
COLORS = (2, 3, 4, 6)  # that the photograph is divided into, one after another
LIGHTNESS_WEIGHT = 0.6  # against a* and b*: shadows divide foods
LEAST_SHARE, MOST_SHARE = 0.004, 0.5  # of the photograph: a piece's own pixels, its box
SAME_IOU = 0.7  # two boxes that overlap more are one
SEED = 1
ROUNDS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 12, 0.5)


def propose_boxes(pixels_bgr: ImageArray) -> list[Box]:
    """Boxes, px, the largest first; the photograph's middle alone where nothing stands out."""
    height, width = pixels_bgr.shape[:2]
    scale = LONG_SIDE_PX / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.GaussianBlur(
        cv2.resize(pixels_bgr, size, interpolation=cv2.INTER_AREA), (0, 0), SMOOTHING_SD_PX
    )
    lab = lab_of(small)
    lab = lab * np.array([LIGHTNESS_WEIGHT, 1.0, 1.0], np.float32)
    boxes = [box for colors in COLORS for box in _pieces(lab, colors)]
    kept: list[Box] = []
    for box in sorted(boxes, key=lambda each: -each[2] * each[3]):
        if all(overlap(box, other) < SAME_IOU for other in kept):
            kept.append(box)
    if not kept:
        return [(0.1 * width, 0.1 * height, 0.8 * width, 0.8 * height)]
    return [(x / scale, y / scale, across / scale, down / scale) for x, y, across, down in kept]


def overlap(a: Box, b: Box) -> float:
    """Intersection over union of two boxes."""
    shared = _shared(a, b)
    return shared / (a[2] * a[3] + b[2] * b[3] - shared)


def share_of_smaller(a: Box, b: Box) -> float:
    """Intersection of two boxes, as a share of the smaller one."""
    return _shared(a, b) / min(a[2] * a[3], b[2] * b[3])


def _shared(a: Box, b: Box) -> float:
    across = max(0.0, min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0]))
    down = max(0.0, min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1]))
    return across * down


def _pieces(lab: np.ndarray, colors: int) -> list[Box]:
    height, width = lab.shape[:2]
    if height * width < colors:
        return []
    cv2.setRNGSeed(SEED)
    places = np.zeros((height * width, 1), np.int32)
    _, nearest, _ = cv2.kmeans(lab.reshape(-1, 3), colors, places, ROUNDS, 1, cv2.KMEANS_PP_CENTERS)
    label_of = np.asarray(nearest).reshape(height, width)
    boxes: list[Box] = []
    for color in range(colors):
        piece = cv2.morphologyEx(
            (label_of == color).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)
        )
        _, _, stats, _ = cv2.connectedComponentsWithStats(piece)
        for x, y, across, down, area in stats[1:].tolist():
            is_whole = x > 1 and y > 1 and x + across < width - 1 and y + down < height - 1
            share = across * down / (height * width)
            if is_whole and area >= LEAST_SHARE * height * width and share <= MOST_SHARE:
                boxes.append((float(x), float(y), float(across), float(down)))
    return boxes
