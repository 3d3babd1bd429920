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
from app.vision.tuning import SIDE_TUNING as TUNING

SEED = 1  # of the clusters that GrabCut begins with


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
                odds[row] = TUNING.cosine_odds * shown @ learned_features(food) + own
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
    size = float(np.log(min(area / photo_px, TUNING.largest_share)))
    return (
        TUNING.size_odds * size + TUNING.fullness_odds * area / (box[2] * box[3]) + TUNING.no_odds
    )


def _cut(pixels_bgr: ImageArray, box: Box) -> tuple[Region, float] | None:
    """Return what differs in a box from what is around it, and by how much the picture was reduced."""
    x, y, across, down = box
    grown, margin = TUNING.grown, TUNING.margin
    height, width = pixels_bgr.shape[:2]
    left, top = int(max(x - margin * across, 0)), int(max(y - margin * down, 0))
    right = int(min(x + (1 + margin) * across, width))
    bottom = int(min(y + (1 + margin) * down, height))
    scale = min(TUNING.piece_px / max(across, down), 1.0)
    picture = cv2.resize(
        pixels_bgr[top:bottom, left:right], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    labels = np.full(picture.shape[:2], cv2.GC_BGD, np.uint8)
    first, last = (
        np.rint((np.array(corner) - [left, top]) * scale).astype(np.int64)
        for corner in (
            (x - grown * across, y - grown * down),
            (x + (1 + grown) * across, y + (1 + grown) * down),
        )
    )
    labels[max(first[1], 0) : last[1], max(first[0], 0) : last[0]] = cv2.GC_PR_FGD
    inside = np.count_nonzero(labels)
    if inside == labels.size:
        return None
    cv2.setRNGSeed(SEED)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(picture, labels, (0, 0, 1, 1), *models, TUNING.cut_rounds, cv2.GC_INIT_WITH_MASK)
    food = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    opened = cv2.morphologyEx(food, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    if not 0 < np.count_nonzero(opened) < TUNING.most_of_box * inside:
        return None
    return Region(np.asarray(picture, np.uint8), largest_part(opened)), scale
