"""The cells of printed tags: which are black, and what a photograph shows of them.

Dictionary and number in -> black and white cells; with a photograph and the tag's corners -> their pixels.
"""

import functools

import cv2
import numpy as np

from app.vision.geometry.pictures import sampled
from app.vision.geometry.projective import map_points
from app.vision.marker_spec import DICTIONARIES, TagBoard
from app.vision.model import Float64Array, ImageArray, MaskArray

# cells from a cell's middle
IN_CELL = np.stack(np.meshgrid([-0.2, 0.0, 0.2], [-0.2, 0.0, 0.2]), -1).reshape(-1, 2)


@functools.lru_cache(maxsize=4096)
def black_cells(dictionary: str, tag: int) -> MaskArray:
    """(bits + 2, bits + 2) cells that are printed black, the border included, row 0 at the top."""
    cells = DICTIONARIES[dictionary][1] + 2
    predefined = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    black = np.asarray(cv2.aruco.generateImageMarker(predefined, tag, cells)) < 128
    black.flags.writeable = False  # shared by all who ask
    return black


def read_tag_cells(
    image: ImageArray, spec: TagBoard, tag: int, corners_px: Float64Array
) -> tuple[ImageArray, ImageArray]:
    """Pixels of a tag's black and of its white cells, (n[, k]) each, nearest neighbours. No tag is all black.

    image: (H, W[, k]). corners_px: (4, 2), clockwise on the print from the upper left.
    """
    is_black = black_cells(spec.dictionary, tag)
    cells = len(is_black)
    frame = np.array([[0.0, 0.0], [cells, 0.0], [cells, cells], [0.0, cells]], np.float32)
    homography = np.asarray(
        cv2.getPerspectiveTransform(frame, corners_px.astype(np.float32)), np.float64
    )

    def pixels(mask: MaskArray) -> ImageArray:
        rows, columns = np.nonzero(mask)
        places = (np.stack([columns, rows], axis=1)[:, None] + 0.5 + IN_CELL).reshape(-1, 2)
        return np.asarray(
            sampled(image, map_points(homography, places)[:, None], cv2.INTER_NEAREST, beyond=None)
        )[:, 0]

    return pixels(is_black), pixels(~is_black)
