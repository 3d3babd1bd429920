"""Which tags of which dictionaries a photograph can show at all, before OpenCV's detector looks for them.

Grey image in -> bits of its quadrangles -> numbers of tags. The detector compares each quadrangle with every tag of a
dictionary, which takes seconds with ten of them. Here the bits of the same quadrangles are looked up; the detector
needs only the tags that are found so, and nothing at all where there are none. It decides which of them are seen.
"""

import functools
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.model import Float32Array, ImageArray, Int64Array

BitsArray = NDArray[np.uint64]

PATTERNS_AT_ONCE = 64  # compared with all tags of a dictionary: 5 MB for the largest


class TagQuads:
    """The quadrangles that OpenCV's detector looks at in a photograph with these parameters.

    The detector joins neighbouring ones and leaves out those at the photograph's border; here are all.
    """

    def __init__(self, grey: ImageArray, parameters: cv2.aruco.DetectorParameters) -> None:
        self._grey = grey
        self.parameters = parameters
        self._patterns: dict[int, tuple[BitsArray, BitsArray]] = {}

    def possible_tags(self, name: str, errors: int, *, is_mirrored: bool = False) -> Int64Array:
        """Numbers of the dictionary's tags that some quadrangle shows with so many wrong bits at most, ascending."""
        tags = _tag_bits(name)
        side = dictionary_of(name).markerSize
        not_black, not_white = self._patterns_of(side)
        if is_mirrored:
            not_black, not_white = (_mirrored(bits, side) for bits in (not_black, not_white))
        is_possible = np.zeros(len(tags), np.bool_)
        for start in range(0, len(not_black), PATTERNS_AT_ONCE):
            at = slice(start, start + PATTERNS_AT_ONCE)
            black, unsure = not_black[at, None, None], (not_black ^ not_white)[at, None, None]
            wrong = np.bitwise_count(
                black ^ (unsure & tags)
            )  # a cell that is neither is wrong either way
            is_possible |= (wrong <= errors).any(axis=(0, 2))
        return np.flatnonzero(is_possible)

    @functools.cached_property
    def _quads_px(self) -> list[Float32Array]:
        return _all_quads(self._grey, self.parameters)

    def _patterns_of(self, side: int) -> tuple[BitsArray, BitsArray]:
        """(n,) cells of side x side bits that are not black, and that are not white, each pattern once."""
        if side not in self._patterns:
            cells = list(_framed_cells(self._grey, self._quads_px, side, self.parameters))
            whites = np.array(cells, np.int64).reshape(-1, side * side)
            full = self.parameters.perspectiveRemovePixelPerCell**2
            limit = self.parameters.validBitIdThreshold * full
            both = np.stack([_packed(whites > limit), _packed(whites < full - limit)], axis=1)
            unique = np.unique(both, axis=0)
            self._patterns[side] = unique[:, 0], unique[:, 1]
        return self._patterns[side]


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's, whose names of AprilTags have a capital H too."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def tags_of(name: str, numbers: Int64Array) -> cv2.aruco.Dictionary:
    """The named dictionary with these tags alone, numbered anew."""
    dictionary = dictionary_of(name)
    tags = np.ascontiguousarray(dictionary.bytesList[numbers])
    return cv2.aruco.Dictionary(tags, dictionary.markerSize, dictionary.maxCorrectionBits)


def _all_quads(grey: ImageArray, parameters: cv2.aruco.DetectorParameters) -> list[Float32Array]:
    """(4, 2) px each, clockwise: what a detector rejects that joins nothing and whose one tag is never seen."""
    alone = cv2.aruco.DetectorParameters()
    alone.minMarkerPerimeterRate = parameters.minMarkerPerimeterRate
    alone.minMarkerDistanceRate = 0.0
    alone.minDistanceToBorder = 0
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    unseen = cv2.aruco.Dictionary(
        np.ascontiguousarray(dictionary.bytesList[:1]), dictionary.markerSize, -1
    )
    alone.errorCorrectionRate = 1.0
    _, _, rejected = cv2.aruco.ArucoDetector(unseen, alone).detectMarkers(grey)
    return [np.asarray(quad, np.float32).reshape(4, 2) for quad in rejected]


def _framed_cells(
    grey: ImageArray,
    quads_px: list[Float32Array],
    side: int,
    parameters: cv2.aruco.DetectorParameters,
) -> Iterator[Int64Array]:
    """(side, side) white pixels in each cell of the quadrangles whose frame is black, as the detector counts them."""
    step = parameters.perspectiveRemovePixelPerCell
    cells = side + 2 * parameters.markerBorderBits
    size = cells * step
    corners = np.array([[0, 0], [size - 1, 0], [size - 1, size - 1], [0, size - 1]], np.float32)
    most_wrong = int(side * side * parameters.maxErroneousBitsInBorderRate)
    edge = step // 2
    for quad in quads_px:
        straight = cv2.warpPerspective(
            grey, cv2.getPerspectiveTransform(quad, corners), (size, size), flags=cv2.INTER_NEAREST
        )
        mean, spread = cv2.meanStdDev(straight[edge : size - edge, edge : size - edge])
        if spread[0, 0] < parameters.minOtsuStdDev:
            if mean[0, 0] <= 127:
                yield np.zeros((side, side), np.int64)
            continue
        _, white = cv2.threshold(straight, 125, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        counts = white.reshape(cells, step, cells, step).sum(axis=(1, 3), dtype=np.int64)
        inner = counts[1:-1, 1:-1]
        is_light = counts > parameters.validBitIdThreshold * step**2
        if np.count_nonzero(is_light) - np.count_nonzero(is_light[1:-1, 1:-1]) <= most_wrong:
            yield inner


@functools.lru_cache(maxsize=16)
def _tag_bits(name: str) -> BitsArray:
    """(n, 4) bits of each tag in its four turns."""
    dictionary = dictionary_of(name)
    bits = dictionary.markerSize**2
    turned = np.asarray(dictionary.bytesList).reshape(
        len(dictionary.bytesList), 4, -1
    )  # the last byte is not filled
    packed = np.zeros(turned.shape[:2], np.uint64)
    for at in range(turned.shape[2]):
        packed = (packed << np.uint64(min(8, bits - 8 * at))) | turned[:, :, at].astype(np.uint64)
    packed.flags.writeable = False  # shared by all who ask
    return packed


def _packed(cells: NDArray[np.bool_]) -> BitsArray:
    """(n,) numbers of the rows of (n, bits), the first cell's bit the highest."""
    weights = np.uint64(1) << np.arange(cells.shape[1], dtype=np.uint64)[::-1]
    return np.asarray((cells * weights).sum(axis=1, dtype=np.uint64), np.uint64)


def _mirrored(patterns: BitsArray, side: int) -> BitsArray:
    """The patterns of side x side cells as a mirror shows them."""
    places = np.arange(side * side, dtype=np.uint64)[::-1]
    cells = (patterns[:, None] >> places) & np.uint64(1)
    return _packed(
        cells.reshape(-1, side, side)[:, :, ::-1].reshape(-1, side * side).astype(np.bool_)
    )
