"""Small operations on pictures that several steps need: grey, CIELAB, blur, fewer pixels, values between them."""

import math
import mmap

import cv2
import numpy as np

from app.vision.model import Float32Array, Float64Array, ImageArray


def grey_of(image_bgr: ImageArray) -> ImageArray:
    """(H, W) grey levels."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)


def lab_of(image_bgr: cv2.typing.MatLike) -> Float32Array:
    """(H, W, 3) CIE L*a*b*."""
    return np.asarray(
        cv2.cvtColor(image_bgr.astype(np.float32) / np.float32(255.0), cv2.COLOR_BGR2LAB),
        np.float32,
    )


class LabPicture:
    """A picture in CIE L*a*b*, converted only where it is looked at: foods cover little of a photograph."""

    def __init__(self, image_bgr: ImageArray) -> None:
        self._image_bgr = image_bgr
        self._lab = _sparse_zeros(image_bgr.shape)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self._image_bgr.shape[0], self._image_bgr.shape[1]

    def within(self, window: tuple[slice, slice]) -> Float32Array:
        """(H, W, 3) L*a*b*, valid within the window, (rows, columns)."""
        self._lab[window] = lab_of(self._image_bgr[window])
        return self._lab


def _sparse_zeros(shape: tuple[int, ...]) -> Float32Array:
    """Return zeros that take memory only in pages that are written to; NumPy's own come in huge pages where allowed."""
    try:
        memory = mmap.mmap(-1, 4 * math.prod(shape), access=mmap.ACCESS_COPY)
    except OSError as error:
        raise MemoryError(f"There is no memory for a picture of {shape} numbers.") from error
    return np.frombuffer(memory, np.float32).reshape(shape)


def lab_bytes(image_bgr: ImageArray) -> Float32Array:
    """(H, W, 3) the same in steps of a byte, 0 to 255."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2LAB), np.float32)


def blurred(image: Float32Array, sd_px: float) -> Float32Array:
    """The picture under a Gaussian."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sd_px), np.float32)


def reduce_by(image: ImageArray, factor: int) -> ImageArray:
    """The image with blocks of factor x factor px averaged; a whole factor takes a tenth of any other's time."""
    if factor == 1:
        return image
    height, width = (side // factor * factor for side in image.shape[:2])
    size = (width // factor, height // factor)
    return np.asarray(
        cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA), np.uint8
    )


def scaled_and_shifted(places: Float32Array, scale: float, shift: Float64Array) -> Float32Array:
    """(H, W, 2) scale * places + shift; NumPy takes fifty times as long to add the few numbers of each place."""
    return np.asarray(cv2.transform(places, np.column_stack([scale * np.eye(2), shift])))


def sampled(
    image: np.ndarray,
    places_px: Float32Array | Float64Array,
    interpolation: int = cv2.INTER_LINEAR,
    *,
    beyond: float | None = 0.0,
) -> np.ndarray:
    """The picture at places (..., 2), x and y in px. beyond: its value outside; None: that of the nearest border."""
    x, y = (np.ascontiguousarray(places_px[..., axis], np.float32) for axis in (0, 1))
    border = cv2.BORDER_REPLICATE if beyond is None else cv2.BORDER_CONSTANT
    return cv2.remap(image, x, y, interpolation, borderMode=border, borderValue=(beyond or 0.0,))
