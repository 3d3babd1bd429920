"""A stored description becomes examples of an index: what is erased, damaged or of another version becomes none."""

import numpy as np
import pytest

from app.candidates.vcm_json import FLOAT, StoredPiece
from app.vision.looks.vcm import LENGTH, VCM_VERSION

VIEW = np.linspace(0, 1, LENGTH).astype(FLOAT)


@pytest.mark.parametrize(
    ("version", "vector"),
    [
        (None, None),  # as the entry of an erased item is read
        ("0", VIEW.tobytes()),
        (VCM_VERSION, VIEW[1:].tobytes()),
        (VCM_VERSION, np.full(LENGTH, np.nan, FLOAT).tobytes()),
    ],
)
def test_what_cannot_be_compared_is_no_example(version, vector):
    assert StoredPiece("item", "apple", version, vector).examples() == []


def test_each_view_is_an_example_of_its_share():
    first, second = StoredPiece("photograph", "apple", VCM_VERSION, VIEW.tobytes() * 2).examples()
    assert (first.name, second.name) == ("photograph", "photograph 1")
    assert first.share == second.share == 0.5
    np.testing.assert_allclose(first.vector, VIEW.astype(float))
