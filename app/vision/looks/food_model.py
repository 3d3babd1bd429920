"""Which food a region shows, by a neural network that an operator supplies as ONNX: a classifier or a segmenter.

A photograph and outlines in, probabilities by label out. The network is read by cv2.dnn; a hostile one can crash the
process or take its time and memory, so this runs in the limited child only (children/child.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.colour_correction import apply_colour
from app.vision.model import ColourCorrection, Float32Array, Float64Array, ImageArray, MaskArray

MARGIN = 0.1  # of the outline's box, on each side
LEAST_CORNERS = 3
CLASSIFIER_AXES, SEGMENTER_AXES = 2, 4  # of the output: (1, labels); (1, labels, h, w)
OPENCV_NO_MEMORY = -4  # cv::Error::StsNoMem
MOST_OFF = 0.01  # by which a row of probabilities may miss a sum of 1


@dataclass(frozen=True, slots=True)
class NetworkInput:
    """How a network wants its pixels and what it answers.

    width_px, height_px: of its input (1, 3, height, width). mean, scale: by channel, (value - mean) * scale of values
    from 0 to 255. channels: their order. answers: scores to be normalised, or probabilities. labels: how many.
    """

    width_px: int
    height_px: int
    mean: tuple[float, float, float]
    scale: tuple[float, float, float]
    channels: Literal["rgb", "bgr"]
    answers: Literal["scores", "probabilities"]
    labels: int


def load_network(content: bytes) -> cv2.dnn.Net | Failure:
    """Return the network of an ONNX file. Failure "classifier_not_loaded"."""
    try:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8))
    except cv2.error as error:
        _raise_if_no_memory(error)
        return Failure(
            "classifier_not_loaded", f"OpenCV cannot load the model: {_first_line(error)}"
        )
    if network.empty():
        return Failure("classifier_not_loaded", "OpenCV finds no network in the model.")
    return network


def classify_region(
    network: cv2.dnn.Net,
    form: NetworkInput,
    pixels_bgr: ImageArray,
    rings: Sequence[Float64Array],
    colour: ColourCorrection | None = None,
) -> Float64Array | Failure | None:
    """(labels,) probabilities of what is within an outline; a segmenter's are the mean over the outline's pixels.

    rings: (n, 2) each, px, even-odd rule. None if nothing of it is in view. Failure "classifier_wrong_shape".
    """
    cut = _cut(pixels_bgr, rings, form)
    if cut is None:
        return None
    crop, mask = cut
    if colour is not None:
        crop = apply_colour(crop, colour)
    try:
        network.setInput(_blob(crop, form))
        answer = np.asarray(network.forward(), np.float64)
    except cv2.error as error:
        _raise_if_no_memory(error)
        return _wrong_shape(
            f"it does not accept (1, 3, {form.height_px}, {form.width_px}): {_first_line(error)}"
        )
    if answer.ndim not in (CLASSIFIER_AXES, SEGMENTER_AXES) or answer.shape[:2] != (1, form.labels):
        return _wrong_shape(f"it answers {answer.shape} for {form.labels} labels")
    return _probabilities(
        answer[0].reshape(form.labels, -1), _at_pixels(mask, answer.shape[2:]), form
    )


def _probabilities(
    answer: Float64Array, is_food: MaskArray, form: NetworkInput
) -> Float64Array | Failure:
    """(labels,) from (labels, pixels); is_food: (pixels,)."""
    if not np.isfinite(answer).all():
        return _wrong_shape("it answers numbers that are not finite")
    if form.answers == "scores":
        weights = np.exp(answer - answer.max(axis=0))
        answer = weights / weights.sum(axis=0)
    elif (answer < 0.0).any() or (np.abs(answer.sum(axis=0) - 1.0) > MOST_OFF).any():
        return _wrong_shape("its probabilities do not sum to 1: are they scores?")
    return np.asarray(answer[:, is_food].mean(axis=1), np.float64)


def _at_pixels(mask: MaskArray, shape: tuple[int, ...]) -> MaskArray:
    """(pixels,) the mask at the output's size; all of it where the mask has none of its pixels."""
    if not shape:
        return np.ones(1, np.bool_)
    small = (
        cv2.resize(
            mask.astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST
        ).ravel()
        > 0
    )
    return np.asarray(small if small.any() else np.ones_like(small), np.bool_)


def _cut(
    pixels_bgr: ImageArray, rings: Sequence[Float64Array], form: NetworkInput
) -> tuple[ImageArray, MaskArray] | None:
    """The outline's box with a margin, at the input's size and proportions, and the outline's mask in it."""
    outlines = [ring for ring in rings if len(ring) >= LEAST_CORNERS]
    if not outlines:
        return None
    height, width = pixels_bgr.shape[:2]
    corners = np.concatenate(outlines)
    if not np.isfinite(corners).all():
        return None
    low = np.clip(corners.min(axis=0), 0.0, [width - 1.0, height - 1.0])
    high = np.clip(corners.max(axis=0), 0.0, [width - 1.0, height - 1.0])
    if (high - low < 1.0).any():
        return None
    size = np.array([form.width_px, form.height_px], np.float64)
    scale = float((size / ((high - low) * (1.0 + 2.0 * MARGIN))).min())
    origin = (low + high) / 2 - size / (2 * scale)
    x0, y0 = (int(value) for value in np.floor(np.maximum(origin, 0.0)))
    x1, y1 = (int(value) for value in np.ceil(np.minimum(origin + size / scale, [width, height])))
    # Averaged down before it is placed, or fine texture aliases.
    reduced_px = max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale))
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    part = cv2.resize(pixels_bgr[y0:y1, x0:x1], reduced_px, interpolation=way)
    left, top = (max(0, round(float(value))) for value in (np.array([x0, y0]) - origin) * scale)
    part = part[: form.height_px - top, : form.width_px - left]
    right, bottom = form.width_px - left - part.shape[1], form.height_px - top - part.shape[0]
    crop = cv2.copyMakeBorder(part, top, bottom, left, right, cv2.BORDER_REPLICATE)
    mask = np.zeros(crop.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint((ring - origin) * scale).astype(np.int32) for ring in outlines], 1)
    return np.asarray(crop, np.uint8), mask > 0


def _blob(crop: ImageArray, form: NetworkInput) -> Float32Array:
    """(1, 3, height, width)."""
    pixels = crop[..., ::-1] if form.channels == "rgb" else crop
    values = (pixels.astype(np.float32) - np.array(form.mean, np.float32)) * np.array(
        form.scale, np.float32
    )
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])


def _wrong_shape(reason: str) -> Failure:
    return Failure("classifier_wrong_shape", f"The model does not fit its description: {reason}.")


def _raise_if_no_memory(error: cv2.error) -> None:
    """Pass a lack of memory on: it is the child's to report."""
    if getattr(error, "code", None) == OPENCV_NO_MEMORY:
        raise error


def _first_line(error: cv2.error) -> str:
    return " ".join(str(error).split())[:200]
