"""Where forms begin in a single view: the silhouette cast onto its support, for each family with its usual height.

Mask, sight and support -> forms to fit. An upright ellipsoid of half-axes a across, b along the line of sight and c
upwards, seen at an elevation e, covers 2 a by 2 sqrt(b^2 + c^2 cot^2 e) of a level plane: with a height over width
that its kind usually has, the silhouette gives all three.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.vision.model import Float64Array, MaskArray
from app.vision.solids.families import MAX_ASPECT, MIN_HALF_MM, Extent, Rectangle, begin_families
from app.vision.solids.form_prior import Heights
from app.vision.solids.forms import E1, LYING, STANDING, TURN_X, TURN_Y, Form, Superellipsoid
from app.vision.solids.prism_starts import begin_prisms, cast
from app.vision.views.sight import Sight

# Height over width, and the spread of its logarithm. Measured on the side photographs of ECUSTFD (Liang and Li, 2017):
# apple, orange, peach, plum, lemon, litchi, kiwifruit, pear and tomato are 0.70 to 0.99 as high as wide; bread,
# mooncake, sachima and bun 0.22 to 0.62; a doughnut 0.36. A heap is nowhere steeper than its angle of repose t, 20 to
# 45 degrees for food: a dome, which has it at its foot alone, is tan(t / 2) / 2 as high as wide, a cone tan(t) / 2,
# together 0.09 to 0.5 with 0.21 in the middle; it is cut in its middle, so that its height changes by twice what its
# half-axis does. What lies is round across, as in a pair.
USUAL_HEIGHTS: Heights = {
    "ball": (0.87, 0.18),
    "heap": (0.21, 0.21),
    "slab": (0.38, 0.5),
    "ring": (0.36, 0.2),
    "block": (0.38, 0.5),
    "wedge": (0.38, 0.5),
}
LYING_HEIGHT = 1.0  # over the width across, where such a food begins
# its volume half of base times height: between a cone's third and a dome's two
HEAP_LOG_EXPONENT = float(np.log(1.35))
HEAP_SUNK_SD_MM = 2.0
ROUNDS = 30
MIN_CAST_PX = 30


def single_view_forms(
    sight: Sight,
    mask: MaskArray,
    support_mm: float,
    support_sd_mm: float,
    heights: Heights = USUAL_HEIGHTS,
) -> list[Form]:
    """Forms to try of a food whose mask (H, W) is all that is known. Empty where its rays miss the support.

    heights: of families, over their widths, with the spread of the logarithm.
    """
    forms: list[Form] = []
    for name in ("heap", "slab", "ring", "ball", *LYING):
        height_of_width = LYING_HEIGHT if name in LYING else heights[name][0]
        extent = _extent(sight, mask, support_mm, height_of_width)
        if extent is not None:
            forms += [
                each
                for each in begin_families(extent, support_mm, support_sd_mm)
                if each.name == name
            ]
    extent = _extent(sight, mask, support_mm, heights["slab"][0])
    if extent is not None:
        forms += begin_prisms(sight, mask, extent.height_mm, support_mm, support_sd_mm)
    return [_as_usual_heap(form) for form in forms]


def with_usual_height(form: Form, heights: Heights) -> Form:
    """Return the form with the height that its family usually has; none where nothing is known of it."""
    if form.name not in heights:
        return form
    height, sd = heights[form.name]
    return replace(form, usual_height=(float(np.log(height)), sd))


def upright(form: Form) -> Form:
    """Return what rests on its flat side so that it does not tilt: from the side, a tilted disc looks like a ball."""
    if form.name not in STANDING:
        return form
    return replace(form, free=tuple(each for each in form.free if each not in (TURN_X, TURN_Y)))


def _as_usual_heap(form: Form) -> Form:
    """Return a heap with the slope and depth that heaps have, which a single view hardly shows; others as they are."""
    if form.name != "heap" or not isinstance(form, Superellipsoid):
        return form
    parameters = form.parameters.copy()
    parameters[E1] = HEAP_LOG_EXPONENT
    return replace(form, parameters=parameters, sunk_sd_mm=HEAP_SUNK_SD_MM)


@dataclass(frozen=True, slots=True)
class _Cast:
    """A mask on a level plane: middle (2,) mm, covariance (2, 2) mm^2. towards: (2,) away from the camera, cot of e."""

    middle: Float64Array
    covariance: Float64Array
    away: Float64Array
    cot: float


def _extent(
    sight: Sight, mask: MaskArray, support_mm: float, height_of_width: float
) -> Extent | None:
    """The ellipsoid of this height over its width whose silhouette has the mask's second moments."""
    seen = _on_plane(sight, mask, support_mm)
    if seen is None:
        return None
    height = 0.0
    for _ in range(ROUNDS):
        # Seen at its middle's height; an ellipse's covariance is a quarter of its squared half-axes.
        seen = _on_plane(sight, mask, support_mm + height / 2)
        if seen is None:
            return None
        lift = (height / 2 * seen.cot) ** 2 / 4
        own = seen.covariance - lift * np.outer(seen.away, seen.away)
        variance, axes = np.linalg.eigh(own)
        least = float(np.trace(seen.covariance)) / 2 / MAX_ASPECT**2
        long, short = 2 * np.sqrt(max(variance[1], least)), 2 * np.sqrt(max(variance[0], least))
        width = short if height_of_width == 1.0 else np.sqrt(long * short)
        height += 0.5 * (2 * width * height_of_width - height)
    heading = float(np.arctan2(axes[1, 1], axes[0, 1]))
    return Extent(
        middle_mm=seen.middle,
        radius_mm=float(np.sqrt(long * short)),
        aspect=float(min(long / short, MAX_ASPECT)),
        heading=heading,
        height_mm=max(height, 2 * MIN_HALF_MM),
        top=Rectangle(seen.middle, (float(long), float(short)), heading),
    )


def _on_plane(sight: Sight, mask: MaskArray, level_mm: float) -> _Cast | None:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    outline = np.asarray(max(contours, key=cv2.contourArea), np.float64).reshape(-1, 2)
    places = cast(sight, outline, level_mm)
    if places is None or len(places) < MIN_CAST_PX:
        return None
    moments = cv2.moments(places.astype(np.float32).reshape(-1, 1, 2))
    area = moments["m00"]
    if area <= 0:
        return None
    middle = np.array([moments["m10"], moments["m01"]]) / area
    covariance = (
        np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / area
    )
    flat = middle - sight.cameras_mm[0][:2]
    far = max(float(np.linalg.norm(flat)), 1e-9)
    return _Cast(middle, covariance, flat / far, far / float(sight.cameras_mm[0][2] - level_mm))
