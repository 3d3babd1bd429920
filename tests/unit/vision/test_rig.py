"""A rig file's keys: what is read, what is refused and with which code."""

import copy
import math

import numpy as np
import pytest

from app.core.errors import Failure, InvalidInputError
from app.vision.rig import adapt_rig, rig_from_mapping

LENS = {"fx": 1000.0, "fy": 1001.0, "cx": 511.5, "cy": 383.5, "distortion": [0.05, -0.1, 0.0, 0.0, 0.0]}
FILE = {
    "width": 1024,
    "height": 768,
    "left": LENS,
    "right": LENS,
    "R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "t_mm": [-60.0, 0.0, 0.0],
}


def changed(**values):
    return copy.deepcopy(FILE) | values


def test_rotation_is_made_orthonormal_from_its_digits():
    turn = math.radians(2)
    rows = [
        [round(math.cos(turn), 4), round(-math.sin(turn), 4), 0],
        [round(math.sin(turn), 4), round(math.cos(turn), 4), 0],
    ]
    rotation = rig_from_mapping(changed(R=[*rows, [0, 0, 1]])).right_from_left
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("data", "code", "word"),
    [
        ([], "rig_invalid", "object"),
        (changed(left=3), "rig_invalid", "left must be an object"),
        (changed(left={"fx": 1}), "camera_invalid", "lacks"),
        (changed(R=[[1, 0, 0], [0, 1, 0]]), "rig_invalid", "three rows"),
        (changed(R=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "rig_invalid", "no rotation"),
        (changed(R=[[1, 0, 0], [0, 1, 0], [0, 0, "1"]]), "rig_invalid", "numbers"),
        (changed(t_mm=[-60.0, 0.0]), "rig_invalid", "3 numbers"),
        (changed(t_mm=[-0.06, 0.0, 0.0]), "rig_invalid", "millimetres"),
    ],
)
def test_file_that_is_no_rig_is_refused_with_the_reason(data, code, word):
    with pytest.raises(InvalidInputError) as refused:
        rig_from_mapping(data)
    assert refused.value.code == code
    assert word in refused.value.message


def test_photographs_of_half_the_size_have_half_the_focal_length_and_turned_or_cropped_ones_are_refused():
    left, right = adapt_rig(rig_from_mapping(FILE), (512, 384), (1024, 768))
    assert (left.fx, right.fx) == (500.0, 1000.0)
    for size in ((768, 1024), (1024, 700)):  # turned, cropped
        failure = adapt_rig(rig_from_mapping(FILE), (1024, 768), size)
        assert isinstance(failure, Failure)
        assert failure.code == "camera_mismatch"
        assert "right" in failure.message
