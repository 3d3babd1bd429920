import math

import cv2
import numpy as np
import pytest

from app.vision.looks.vcm_shape import CELLS, DIRECTIONS, oriented_gradients, outline_measures, radial_descriptors
from tests.unit.vision.food_regions import ellipse_mask, lopsided_mask

ELONGATION, RECTANGULARITY, CIRCULARITY, SOLIDITY = range(4)
PIXELS = 0.03  # outlines run through pixels' centres, in steps
STEPS = 0.12  # a round outline's length in steps of pixels is some 5 % too long, which counts twice


def box_mask(across: int, down: int) -> np.ndarray:
    mask = np.zeros((160, 160), bool)
    mask[80 - down // 2 : 80 + down // 2, 80 - across // 2 : 80 + across // 2] = True
    return mask


def test_disc_has_the_measures_of_a_disc():
    measures = outline_measures(ellipse_mask(60, 60))
    assert measures[ELONGATION] == pytest.approx(1.0, abs=PIXELS)
    assert measures[RECTANGULARITY] == pytest.approx(math.pi / 4, abs=PIXELS)
    assert measures[CIRCULARITY] == pytest.approx(1.0, abs=STEPS)
    assert measures[SOLIDITY] == pytest.approx(1.0, abs=PIXELS)


def test_hus_moments_are_those_of_the_whole_mask_by_their_definition():
    mask = lopsided_mask()
    rows, columns = np.nonzero(mask)
    x, y, area = columns - columns.mean(), rows - rows.mean(), float(len(rows))

    def eta(p: int, q: int) -> float:
        return float((x**p * y**q).sum() / area ** (1 + (p + q) / 2))

    first = eta(2, 0) + eta(0, 2)
    second = (eta(2, 0) - eta(0, 2)) ** 2 + 4 * eta(1, 1) ** 2
    third = (eta(3, 0) - 3 * eta(1, 2)) ** 2 + (3 * eta(2, 1) - eta(0, 3)) ** 2
    told = outline_measures(mask)[4:7]  # of the polygon through the outer pixels' centres, half a pixel smaller
    assert told == pytest.approx([-math.log10(first), -math.log10(second), -math.log10(third)], abs=0.05)
    by_opencv = cv2.HuMoments(cv2.moments(mask.astype(np.uint8), binaryImage=True)).ravel()[:3]
    assert [first, second, third] == pytest.approx(by_opencv, rel=1e-6)


def test_largest_piece_alone_is_measured():
    whole = ellipse_mask(40, 30)
    with_crumb = whole.copy()
    with_crumb[2:6, 2:6] = with_crumb[150:154, 150:154] = True
    assert outline_measures(with_crumb).tolist() == outline_measures(whole).tolist()
    assert radial_descriptors(with_crumb).tolist() == radial_descriptors(whole).tolist()


def test_radial_spectrum_of_a_disc_is_empty_and_of_others_begins_at_their_symmetry():
    assert (radial_descriptors(ellipse_mask(60, 60)) < -5.0).all()
    assert radial_descriptors(ellipse_mask(70, 35)).argmax() == 1  # twice around
    assert radial_descriptors(box_mask(100, 100)).argmax() == 3  # four times
    angles = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    radii = 50.0 * (1.0 + 0.2 * np.cos(3.0 * angles))
    clover = np.zeros((160, 160), np.uint8)
    corners = np.stack([80 + radii * np.cos(angles), 80 + radii * np.sin(angles)], axis=1)
    cv2.fillPoly(clover, [np.round(corners).astype(np.int32)], 1)
    # a cosine of 0.2 of the mean has half of it in its harmonic
    assert radial_descriptors(clover > 0)[2] == pytest.approx(math.log(0.1), abs=0.1)


@pytest.mark.parametrize(("axis", "direction"), [(1, 0), (0, DIRECTIONS // 2)])
def test_stripes_have_gradients_across_them_alone(axis, direction):
    stripes = np.indices((160, 160))[axis] // 10 % 2 * 200
    gradients = oriented_gradients(stripes.astype(np.uint8), box_mask(120, 120)).reshape(CELLS, CELLS, DIRECTIONS)
    assert (gradients**2).sum() == pytest.approx(1.0)
    assert (gradients[..., direction] ** 2).sum() > 0.99
    assert (gradients[..., direction] ** 2).sum(axis=1 - axis) == pytest.approx(0.25, abs=0.05)
