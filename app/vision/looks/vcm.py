"""The vector of a food region, versioned: Visual Characterization Metrics (VCM) and learned features.

The food table is indexed by these (TADA, step 7). Families and measures follow what TADA used: colour moments and
histograms in CIELAB and HSV, Gabor energies, local features (Zhu et al., "The use of mobile devices in aiding dietary
assessment and evaluation", IEEE J. Sel. Top. Signal Process. 4(4), 2010; Bosch et al., "Combining global and local
features for food identification in dietary assessment", ICIP 2011); each block names its own source where it is made.

A block is a histogram (square roots of shares, so that distances between two are Hellinger's) or a set of measures
(each in its own unit; whoever compares them brings them to one scale).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from app.vision.board.colour_correction import apply_colour
from app.vision.geometry.masks import eroded
from app.vision.geometry.pictures import grey_of, lab_of
from app.vision.looks import learned_features, vcm_color, vcm_shape, vcm_texture
from app.vision.looks.vcm_region import Region, region_of_rings
from app.vision.model import ColourCorrection, Float32Array, Float64Array, ImageArray, MaskArray

VCM_VERSION = "2"  # changes whenever the same region may give another vector

BlockKind = Literal["histogram", "measures"]


@dataclass(frozen=True, slots=True)
class Block:
    """A part of the vector: its name, how many numbers, how it is compared, and what makes it."""

    name: str
    size: int
    kind: BlockKind
    make: Callable[["Surface"], Float64Array]


@dataclass(frozen=True, slots=True)
class Surface:
    """A region and what several blocks need of it.

    inner: (h, w), the mask without its outline, where the background mixes in. grey: (h, w). lab: (h, w, 3) CIELAB
    (D65), L 0 to 100.
    """

    region: Region
    inner: MaskArray
    grey: ImageArray
    lab: Float32Array


LEARNED = "learned_features"
BLOCKS: tuple[Block, ...] = (
    Block("lab_histograms", 60, "histogram", lambda of: vcm_color.lab_histograms(of.lab[of.inner])),
    Block(
        "hue_saturation_histograms",
        26,
        "histogram",
        lambda of: vcm_color.hue_saturation(of.region, of.inner),
    ),
    Block("lab_rings", 18, "measures", lambda of: vcm_color.lab_rings(of.lab, of.region.mask)),
    Block("lab_moments", 24, "measures", lambda of: vcm_color.lab_moments(of.lab[of.inner])),
    Block(
        "binary_patterns",
        60,
        "histogram",
        lambda of: vcm_texture.binary_patterns(of.grey, of.inner),
    ),
    Block(
        "colour_binary_patterns",
        20,
        "histogram",
        lambda of: vcm_texture.color_patterns(of.lab, of.inner),
    ),
    Block(
        "gabor_energies", 9, "measures", lambda of: vcm_texture.gabor_energies(of.grey, of.inner)
    ),
    Block(
        "gradient_sizes", 6, "measures", lambda of: vcm_texture.gradient_sizes(of.grey, of.inner)
    ),
    Block(
        "oriented_gradients",
        128,
        "histogram",
        lambda of: vcm_shape.oriented_gradients(of.grey, of.region.mask),
    ),
    Block("outline_measures", 8, "measures", lambda of: vcm_shape.outline_measures(of.region.mask)),
    Block(
        "radial_descriptors",
        12,
        "measures",
        lambda of: vcm_shape.radial_descriptors(of.region.mask),
    ),
    Block(
        LEARNED,
        learned_features.LENGTH,
        "histogram",
        lambda of: learned_features.learned_features(of.region),
    ),
)
LENGTH = sum(block.size for block in BLOCKS)
# of each version that can be compared: an earlier one lacks what was added at the end
LENGTHS = {"1": LENGTH - learned_features.LENGTH, VCM_VERSION: LENGTH}
OUTLINE_PX = 3
LEAST_INNER_PX = 200  # a sliver has no inside: all of it is taken


def describe_rings(
    pixels_bgr: ImageArray, rings: Sequence[Float64Array], colour: ColourCorrection | None
) -> Float32Array | None:
    """The vector of the region within outlines, px, in corrected colours; None where nothing of it is in view."""
    region = region_of_rings(pixels_bgr, rings)
    if region is None:
        return None
    if colour is not None:
        region = Region(apply_colour(region.pixels_bgr, colour), region.mask)
    return describe(region)


def describe(region: Region) -> Float32Array:
    """(LENGTH,) float32: the region's vector, finite. Colours are taken as they are: correct them before (color.py).

    Raises ValueError if nothing of the region is marked, or its mask has not the size of its pixels.
    """
    if region.mask.shape != region.pixels_bgr.shape[:2] or not region.mask.any():
        raise ValueError(
            f"a region of {region.pixels_bgr.shape[:2]} px with a mask of {region.mask.shape}, or empty"
        )
    inner = eroded(region.mask, OUTLINE_PX)
    surface = Surface(
        region=region,
        inner=inner if np.count_nonzero(inner) > LEAST_INNER_PX else region.mask,
        grey=grey_of(region.pixels_bgr),
        lab=lab_of(region.pixels_bgr),
    )
    return np.concatenate([block.make(surface) for block in BLOCKS]).astype(np.float32)
