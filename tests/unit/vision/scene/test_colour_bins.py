"""Colours as indices into histograms: the tables of bytes against the computation that they stand for."""

import numpy as np

from app.vision.geometry.pictures import lab_bytes
from app.vision.scene.colour_bins import byte_bins, colour_bins


def test_bins_of_bytes_are_those_that_are_computed():
    image = np.random.default_rng(5).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    image[0] = np.arange(80)[:, None]  # greys
    assert np.array_equal(byte_bins(image), colour_bins(lab_bytes(image)))
