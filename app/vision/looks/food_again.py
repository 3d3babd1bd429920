"""A food found again in a photograph from elsewhere, in which nothing that the first one shows can be matched.

Regions of the foods in the first photograph + the other photograph -> their masks there, of pieces of like colour.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.masks import largest_part
from app.vision.looks.food_boxes import propose_boxes
from app.vision.looks.learned_features import learned_features
from app.vision.looks.vcm_region import Box, Region
from app.vision.model import ImageArray, MaskArray, Photo

SIDE_PX = 128  # of the longer side of a piece's box while it is cut out
GROWN, MARGIN = (
    0.05,
    0.25,
)  # of the box's sides, on each side: what may be food, and what surely is not
ROUNDS = 3
MOST_OF_BOX = 0.98  # of what may be food: more of it, and nothing was cut out
SEED = 1
# Log odds that a piece is the food: by the cosine of their features, by the logarithm of its share of the photograph,
# and by its share of its own box, as shadows and the table between things have less. Fitted to 314 pieces of 70
# photographs of ECUSTFD (Liang and Li, 2017), one of which is the food or none is: the likeliest is right in 90 %, by
# specimens left out, and likelier than none in 86 %.
COSINE_ODDS, SIZE_ODDS, FULLNESS_ODDS, NO_ODDS = 20.1, 1.9, 20.9, -21.4
LARGEST_SHARE = 0.2  # of the photograph: no food is likelier for being larger


@dataclass(frozen=True, slots=True)
class FoodAgain:
    """mask: (h, w) of the food in a part of the photograph, reduced by scale."""

    mask: MaskArray
    scale: float


def find_again(
    foods: Sequence[Region | None], is_pointed: Sequence[bool], photo: Photo
) -> list[FoodAgain | None]:
    """Return where a photograph shows each food; None where nothing in it is likely to be it.

    No piece of the photograph is two foods; those that somebody has pointed at choose first.
    """
    pieces = [_cut(photo.pixels_bgr, box) for box in propose_boxes(photo.pixels_bgr)]
    cut = [piece for piece in pieces if piece is not None]
    odds = np.full((len(foods), len(cut)), -np.inf)
    if cut:
        shown = np.stack([learned_features(region) for region, _ in cut])
        area = photo.pixels_bgr.shape[0] * photo.pixels_bgr.shape[1]
        own = [_odds(region.mask, scale**2 * area) for region, scale in cut]
        for row, food in enumerate(foods):
            if food is not None:
                odds[row] = COSINE_ODDS * shown @ learned_features(food) + own
    again: list[FoodAgain | None] = [None] * len(foods)
    for pointed in (True, False):
        chooses = np.array([each == pointed for each in is_pointed])
        while (likely := np.where(chooses[:, None], odds, -np.inf)).max(initial=0.0) > 0:
            number, piece = divmod(int(likely.argmax()), len(cut))
            again[number] = FoodAgain(cut[piece][0].mask, cut[piece][1])
            odds[number], odds[:, piece] = -np.inf, -np.inf
    return again


def _odds(mask: MaskArray, photo_px: float) -> float:
    """Log odds that a piece is a food by its size and form. photo_px: area of the photograph at the piece's scale."""
    area = float(np.count_nonzero(mask))
    box = cv2.boundingRect(mask.astype(np.uint8))
    size = float(np.log(min(area / photo_px, LARGEST_SHARE)))
    return SIZE_ODDS * size + FULLNESS_ODDS * area / (box[2] * box[3]) + NO_ODDS


def _cut(pixels_bgr: ImageArray, box: Box) -> tuple[Region, float] | None:
    """What differs in a box from what is around it, and by how much the picture was reduced."""
    x, y, across, down = box
    height, width = pixels_bgr.shape[:2]
    left, top = int(max(x - MARGIN * across, 0)), int(max(y - MARGIN * down, 0))
    right = int(min(x + (1 + MARGIN) * across, width))
    bottom = int(min(y + (1 + MARGIN) * down, height))
    scale = min(SIDE_PX / max(across, down), 1.0)
    picture = cv2.resize(
        pixels_bgr[top:bottom, left:right], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    labels = np.full(picture.shape[:2], cv2.GC_BGD, np.uint8)
    first, last = (
        np.rint((np.array(corner) - [left, top]) * scale).astype(np.int64)
        for corner in (
            (x - GROWN * across, y - GROWN * down),
            (x + (1 + GROWN) * across, y + (1 + GROWN) * down),
        )
    )
    labels[max(first[1], 0) : last[1], max(first[0], 0) : last[0]] = cv2.GC_PR_FGD
    inside = np.count_nonzero(labels)
    if inside == labels.size:
        return None
    cv2.setRNGSeed(SEED)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(picture, labels, (0, 0, 1, 1), *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    food = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    opened = cv2.morphologyEx(food, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    if not 0 < np.count_nonzero(opened) < MOST_OF_BOX * inside:
        return None
    return Region(np.asarray(picture, np.uint8), largest_part(opened)), scale
