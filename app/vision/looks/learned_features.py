"""Learned features of a food region, one block of its vector: the activations of a network.

Region -> the mean activations of the last layer of EfficientNet-Lite0 (Tan and Le, "EfficientNet:
Rethinking model scaling for convolutional neural networks", ICML 2019), which are not negative: as
shares of their sum they are compared like a histogram. tools/food_network.py makes the file. Its
licence is beside it.
"""

from functools import cache
from importlib import resources

import cv2
import numpy as np

from app.vision.looks.vcm_region import Region
from app.vision.model import Float64Array, ImageArray

FILE = "efficientnet_lite0.onnx"
LENGTH = 1280
SIDE_PX = 224
ROOM = 0.1  # of the longer side of the region's box, on each side
GREY = 127  # of what is not the food: else the table would be learned with it
SCALE = 128.0


def learned_features(region: Region) -> Float64Array:
    """(LENGTH,) square roots of shares of the network's activations."""
    network = _network()
    network.setInput(
        cv2.dnn.blobFromImage(_square(region), 1.0 / SCALE, mean=(GREY, GREY, GREY), swapRB=True)
    )
    activations = np.asarray(network.forward()[0], np.float64)
    return np.sqrt(activations / max(float(activations.sum()), 1e-12))


def _square(region: Region) -> ImageArray:
    """(SIDE_PX, SIDE_PX, 3) the food alone, in the middle of grey."""
    left, top, across, down = cv2.boundingRect(region.mask.astype(np.uint8))
    scale = SIDE_PX / (max(across, down) * (1.0 + 2.0 * ROOM))
    food = np.where(region.mask[..., None], region.pixels_bgr, np.uint8(GREY))
    shift = SIDE_PX / 2.0 - scale * np.array([left + across / 2.0, top + down / 2.0])
    return np.asarray(
        cv2.warpAffine(
            food,
            np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]]),
            (SIDE_PX, SIDE_PX),
            borderValue=(GREY, GREY, GREY),
        ),
        np.uint8,
    )


@cache
def _network() -> cv2.dnn.Net:
    path = resources.files("app.vision.looks") / FILE
    return cv2.dnn.readNetFromONNX(np.frombuffer(path.read_bytes(), np.uint8))
