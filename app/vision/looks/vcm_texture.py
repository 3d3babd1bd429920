"""VCM of texture: binary patterns, Gabor energies, sizes of gradients. None depends on how the food is turned."""

import cv2
import numpy as np

from app.vision.geometry.masks import resized
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray

PATTERN_SCALES = (1.0, 0.5)
PATTERN_RADII_PX = (1, 2, 3)
NEIGHBOURS = 8
PATTERNS = NEIGHBOURS + 2
LEAST_STEP = 1.0  # grey levels: less is noise
COLOR_STEPS = 4.0  # a unit of a* or b* counts as so many grey levels
COLOR_RADIUS_PX = 2
GABOR_WAVELENGTH_PX, GABOR_SD_PX, GABOR_SIDE_PX = 4.0, 2.0, 11  # at each scale: an octave apart
GABOR_SCALES = (1.0, 0.5, 0.25)
GABOR_ORIENTATIONS = 6
PERCENTILES = (25, 50, 75, 95)


def _pattern_of_code() -> np.ndarray:
    """(256,) code of eight neighbours -> number of a uniform pattern's set bits (0 to 8), or 9 for all others."""
    bits = (np.arange(256)[:, None] >> np.arange(NEIGHBOURS)) & 1
    changes = np.count_nonzero(bits != np.roll(bits, 1, axis=1), axis=1)
    return np.where(changes <= 2, bits.sum(axis=1), NEIGHBOURS + 1)


PATTERN_OF_CODE = _pattern_of_code()


def binary_patterns(grey: ImageArray, inner: MaskArray) -> Float64Array:
    """(60,) rotation-invariant uniform local binary patterns at two scales and three radii.

    Ojala, Pietikäinen and Mäenpää, "Multiresolution gray-scale and rotation invariant texture classification with
    local binary patterns", IEEE PAMI 24(7), 2002: LBP(8, r), riu2; a neighbour counts as brighter from LEAST_STEP on.
    """
    histograms = []
    for scale in PATTERN_SCALES:
        picture, mask = _resized(grey.astype(np.float32), inner, scale)
        histograms += [_pattern_histogram(picture, mask, radius) for radius in PATTERN_RADII_PX]
    return np.concatenate(histograms)


def color_patterns(lab: Float32Array, inner: MaskArray) -> Float64Array:
    """(20,) the same of a* and of b*, at half the size and one radius.

    Mäenpää and Pietikäinen, "Classification with color and texture: jointly or separately?", Pattern Recognition 37(8),
    2004: color and texture apart.
    """
    histograms = []
    for channel in (1, 2):
        picture, mask = _resized(lab[..., channel] * COLOR_STEPS, inner, 0.5)
        histograms.append(_pattern_histogram(picture, mask, COLOR_RADIUS_PX))
    return np.concatenate(histograms)


def gabor_energies(grey: ImageArray, inner: MaskArray) -> Float64Array:
    """(9,) at each of three wavelengths (4, 8, 16 px): log mean response, largest and spread over the mean.

    Manjunath and Ma, "Texture features for browsing and retrieval of image data", IEEE PAMI 18(8), 1996; these
    three over six orientations in place of the responses themselves, which turn with the food.
    """
    values = grey.astype(np.float32) / 255.0
    flat = (values - values[inner].mean()) / (values[inner].std() + 0.02)
    measures: list[float] = []
    for scale in GABOR_SCALES:
        picture, mask = _resized(flat, inner, scale)
        sizes = np.array(
            [np.abs(cv2.filter2D(picture, -1, kernel))[mask].mean() for kernel in GABOR_KERNELS]
        )
        mean = float(sizes.mean())
        measures += [np.log(mean + 1e-4), sizes.max() / (mean + 1e-6), sizes.std() / (mean + 1e-6)]
    return np.array(measures)


def gradient_sizes(grey: ImageArray, inner: MaskArray) -> Float64Array:
    """(6,) mean, standard deviation and percentiles 25 to 95 of log(1 + size) of the Sobel gradient.

    How rough a surface is. Tamura, Mori and Yamawaki, "Textural features corresponding to visual perception", IEEE
    Trans. SMC 8(6), 1978, tell roughness by contrast and coarseness; these are simpler and stand for both.
    """
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    sizes = np.log1p(np.hypot(across, down))[inner]
    return np.concatenate([[sizes.mean(), sizes.std()], np.percentile(sizes, PERCENTILES)]).astype(
        np.float64
    )


def _gabor_kernels() -> list[Float32Array]:
    """Even kernels without a mean, of weight 1, an orientation each."""
    kernels = []
    for step in range(GABOR_ORIENTATIONS):
        angle = np.pi * step / GABOR_ORIENTATIONS
        size = (GABOR_SIDE_PX, GABOR_SIDE_PX)
        kernel = cv2.getGaborKernel(size, GABOR_SD_PX, angle, GABOR_WAVELENGTH_PX, 1.0, 0.0)
        kernel = kernel - kernel.mean()
        kernels.append((kernel / np.abs(kernel).sum()).astype(np.float32))
    return kernels


GABOR_KERNELS = _gabor_kernels()


def _pattern_histogram(picture: Float32Array, mask: MaskArray, radius_px: int) -> Float64Array:
    """(10,) square roots of the patterns' shares. picture: (h, w) float32."""
    framed = np.pad(picture, radius_px, mode="edge")
    code = np.zeros(picture.shape, np.int32)
    for bit in range(NEIGHBOURS):
        angle = 2.0 * np.pi * bit / NEIGHBOURS
        neighbour = _shifted(
            framed, radius_px, radius_px * np.cos(angle), -radius_px * np.sin(angle)
        )
        code |= (neighbour > picture + LEAST_STEP).astype(np.int32) << bit
    counts = np.bincount(PATTERN_OF_CODE[code[mask]], minlength=PATTERNS).astype(np.float64)
    return np.asarray(np.sqrt(counts / counts.sum()), np.float64)


def _shifted(framed: Float32Array, frame_px: int, dx: float, dy: float) -> Float32Array:
    """The picture inside a frame, seen from (dx, dy) px away, between pixels bilinearly."""
    height, width = framed.shape[0] - 2 * frame_px, framed.shape[1] - 2 * frame_px
    dx, dy = round(dx, 9), round(dy, 9)  # a whole number of px stays one
    x, y = frame_px + int(np.floor(dx)), frame_px + int(np.floor(dy))
    fx, fy = float(dx - np.floor(dx)), float(dy - np.floor(dy))
    out = (1 - fx) * (1 - fy) * framed[y : y + height, x : x + width]
    if fx > 1e-6:
        out = out + fx * (1 - fy) * framed[y : y + height, x + 1 : x + 1 + width]
    if fy > 1e-6:
        out = out + (1 - fx) * fy * framed[y + 1 : y + 1 + height, x : x + width]
    if fx > 1e-6 and fy > 1e-6:
        out = out + fx * fy * framed[y + 1 : y + 1 + height, x + 1 : x + 1 + width]
    return out


def _resized(
    picture: Float32Array, mask: MaskArray, scale: float
) -> tuple[Float32Array, MaskArray]:
    """Picture and mask at a scale; the whole picture's mask if nothing of it is left."""
    if scale == 1.0:
        return picture, mask
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
    covered = resized(mask, size)
    return small, covered if covered.any() else np.ones_like(covered)
