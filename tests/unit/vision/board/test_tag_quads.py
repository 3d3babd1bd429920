"""Tags that a photograph can show at all: none that OpenCV's detector sees is left out."""

import cv2
import numpy as np
import pytest

from app.vision.board.tag_quads import TagQuads, dictionary_of, tags_of
from app.vision.model import ImageArray

SIDE_PX, PITCH_PX = 96, 150


def tags_picture(name: str, wrong_bits: int = 0) -> ImageArray:
    """Tags 0 to 19 of a dictionary, turned and with noise, some of whose cells are of the other colour."""
    rng = np.random.default_rng(0)
    dictionary = dictionary_of(name)
    cells = dictionary.markerSize + 2
    picture = np.full((4 * PITCH_PX + 60, 5 * PITCH_PX + 60), 230, np.uint8)
    for tag in range(20):
        printed = np.asarray(cv2.aruco.generateImageMarker(dictionary, tag, cells)).copy()
        for row, column in rng.integers(1, cells - 1, (wrong_bits, 2)):
            printed[row, column] = 255 - printed[row, column]
        x, y = 40 + tag % 5 * PITCH_PX, 40 + tag // 5 * PITCH_PX
        large = cv2.resize(np.rot90(printed, tag % 4), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_NEAREST)
        picture[y : y + SIDE_PX, x : x + SIDE_PX] = large
    noisy = cv2.GaussianBlur(picture, (0, 0), 1.0) + rng.normal(0.0, 2.0, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", ["DICT_6X6_250", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16H5"])
@pytest.mark.parametrize("wrong_bits", [0, 3])
@pytest.mark.parametrize("rate", [0.0, 0.6])
def test_the_detector_sees_the_same_among_the_possible_tags_as_among_all(name, wrong_bits, rate):
    grey = tags_picture(name, wrong_bits)
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = rate
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(name), parameters).detectMarkers(grey)
    seen = np.ravel(ids) if ids is not None else np.empty(0, np.int64)
    assert len(seen) > 0 or wrong_bits > 0
    possible = TagQuads(grey, parameters).possible_tags(name, int(dictionary_of(name).maxCorrectionBits * rate))
    assert set(seen.tolist()) <= set(possible.tolist())
    again, places = (), None
    if len(possible) > 0:
        again, places, _ = cv2.aruco.ArucoDetector(tags_of(name, possible), parameters).detectMarkers(grey)
    assert np.array_equal(possible[np.ravel(places)] if places is not None else possible[:0], seen)
    assert np.array_equal(np.array(again), np.array(corners))
