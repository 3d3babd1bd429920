import pathlib

import cv2
import numpy as np
import pytest

from app.vision.looks.vcm import LENGTH, VCM_VERSION, describe, describe_rings
from app.vision.looks.vcm_region import Region, region_of_box, region_of_rings
from tests.unit.vision.food_regions import LOPSIDED, speckled, speckled_region


def test_vectors_are_those_that_indexes_of_their_version_hold_on_any_number_of_threads():
    """described.npy: of an outline and of a box. Other numbers need another VCM_VERSION, and the file made anew."""
    region = speckled_region()
    before = region.pixels_bgr.copy(), region.mask.copy()
    kept, threads = np.load(pathlib.Path(__file__).parent / "described.npy"), cv2.getNumThreads()
    made = []
    try:
        for count in (1, 3):
            cv2.setNumThreads(count)
            cv2.setRNGSeed(count * 77)
            made.append(np.stack([describe(region), describe(region_of_box(speckled(), (30, 40, 90, 80)))]))
    finally:
        cv2.setNumThreads(threads)
    assert np.array_equal(*made)
    assert made[0] == pytest.approx(kept, abs=2e-3)
    assert (kept.shape, made[0].dtype, VCM_VERSION) == ((2, LENGTH), np.float32, "2")
    assert np.array_equal(region.pixels_bgr, before[0])
    assert np.array_equal(region.mask, before[1])


@pytest.mark.parametrize("colour", [(120, 120, 120), (0, 0, 255)])
@pytest.mark.parametrize("shape", [(1, 1), (1, 160), (160, 1), (3, 2), (160, 160)])
def test_one_colour_one_pixel_and_tiny_pictures_are_described(colour, shape):
    one = np.zeros(shape, bool)
    one[shape[0] // 2, shape[1] // 2] = True
    for mask in (one, np.ones(shape, bool)):
        assert np.isfinite(describe(Region(np.full((*shape, 3), colour, np.uint8), mask))).all()


def test_region_without_food_or_with_another_masks_size_raises():
    with pytest.raises(ValueError, match="mask"):
        describe(Region(speckled(), np.zeros((160, 160), bool)))
    with pytest.raises(ValueError, match="mask"):
        describe(Region(speckled(), np.ones((80, 80), bool)))


def test_outlines_without_a_region_have_no_vector():
    assert describe_rings(speckled(), [LOPSIDED + 1000.0], None) is None
    ours = describe_rings(speckled(), [LOPSIDED], None)
    assert ours.tobytes() == describe(region_of_rings(speckled(), [LOPSIDED])).tobytes()
