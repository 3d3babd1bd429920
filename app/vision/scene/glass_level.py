"""Where a liquid's surface lies that is seen through a glass: a whole circle about the rim's axis, below it.

The rim and both views -> the surface's radius and height. An opaque wall hides the near part of a lower circle, and the
far part of what is painted on it; through glass both are seen, and in both views.
"""

import numpy as np

from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.scene.liquid_level import Level, colours_at, lift_sd_mm, rim_crossing_mm
from app.vision.scene.rims import Circle
from app.vision.views.sight import Sight

BELOW_RIM_MM = 6.0  # nearer circles are the rim's own lower edge
LOWEST_SHARE = 0.12  # of the rim's height: below lie floor and base
RADIUS_SHARES = (0.85, 1.0)  # of the rim's: glasses taper a little
STEP_MM = 1.0
BANDS_MM = (-1.5, -0.5, 0.5, 1.5)  # across the surface's edge, where its colours are taken
SAMPLES, ARCS = 240, 24  # directions, and the arcs over which their noise is averaged
CLEAR_MM = 4.0  # outside the rim's circle, so that the rim's own edge is not the surface's
# of the near part that must lie behind the wall: else an opaque vessel would look the same
LEAST_HIDDEN = 0.3
MOST_STEP = 10.0  # CIELAB: a stronger step of one arc proves no more
LEAST_STEP = 5.0  # CIELAB, in the near and the far part; walls, prints and clear water reach 3.7 where no surface is
LEAST_RATIO = 1.6  # to the next best height: floor and base of a glass are circles as well
FOOT_SHARE = 0.5  # of the rim's height, below which glasses are narrower than their rim: a circle as wide is the foot's
NARROWER_MM = 1.0  # their wall alone is as thick
APART_MM = 5.0  # of two heights that are not one surface's
PEAK_MM = 3.0  # of height and radius together, from the best circle
HEIGHT_SD_MM, RADIUS_SD_MM = 1.0, 0.8  # the wall refracts


def find_level_in_glass(
    sight: Sight, lab: tuple[Float32Array, Float32Array], rim: Circle, table_mm: float
) -> Level | None:
    """The circle whose near and far parts both stand out, alike in both views; None where no height is distinct."""
    lowest = table_mm + LOWEST_SHARE * (rim.height_mm - table_mm)
    heights = np.arange(rim.height_mm - BELOW_RIM_MM, lowest, -STEP_MM)
    radii = np.arange(RADIUS_SHARES[1], RADIUS_SHARES[0], -STEP_MM / rim.radius_mm) * rim.radius_mm
    if not len(heights):
        return None
    steps = np.array([_steps(sight, lab, rim, float(height), radii) for height in heights])
    row, column = np.unravel_index(np.argmax(steps), steps.shape)
    best = float(steps[row, column])
    others = steps[np.abs(heights - heights[row]) > APART_MM]
    if best < LEAST_STEP or (others.size and best < LEAST_RATIO * float(others.max())):
        return None
    is_low = heights[row] < table_mm + FOOT_SHARE * (rim.height_mm - table_mm)
    if is_low and radii[column] > rim.radius_mm - NARROWER_MM:
        return None
    # The middle of the peak: bands are wider than a step.
    beside = (
        np.abs(heights - heights[row])[:, None] + np.abs(radii - radii[column])[None, :] <= PEAK_MM
    )
    weight = np.where(beside, np.maximum(steps - best / 2, 0.0), 0.0)
    height = float((weight.sum(axis=1) @ heights) / weight.sum())
    radius = float((weight.sum(axis=0) @ radii) / weight.sum())
    at = np.array([*rim.centre_mm, radius, height])
    return Level(
        height, radius, (HEIGHT_SD_MM, RADIUS_SD_MM), lift_sd_mm(sight, at), is_in_glass=True
    )


def _steps(
    sight: Sight,
    lab: tuple[Float32Array, Float32Array],
    rim: Circle,
    height_mm: float,
    radii_mm: Float64Array,
) -> Float64Array:
    """(n,) geometric mean of the CIELAB steps that both views share across the circles' near and far parts."""
    cameras = sight.cameras_mm
    away = rim.centre_mm - (cameras[0] + cameras[1])[:2] / 2
    angle = (np.arange(ARCS) + 0.5) * (2 * np.pi / ARCS)
    towards = np.column_stack([np.cos(angle), np.sin(angle)]) @ (away / np.linalg.norm(away))
    by_view = []
    for view in (0, 1):
        rings = [
            rim.ring(radius + band, height_mm, SAMPLES)
            for radius in radii_mm.tolist()
            for band in BANDS_MM
        ]
        colours = colours_at(lab[view], sight.in_view(*sight.project(np.vstack(rings)), view))
        bands = colours.reshape(len(radii_mm), len(BANDS_MM), ARCS, -1, 3).mean(axis=3)
        by_view.append((bands[:, 2] + bands[:, 3] - bands[:, 0] - bands[:, 1]) / 2)
    # Noise of one view is not the other's: it goes from the product.
    product = (by_view[0] * by_view[1]).sum(axis=-1)
    shared = np.clip(np.sign(product) * np.sqrt(np.abs(product)), -MOST_STEP, MOST_STEP)
    # The sides are seen at a grazing angle, where the wall's refraction moves the edge.
    far, near = (np.maximum(side, 0.0) ** 2 for side in (towards, -towards))
    hidden = near * _behind_wall(sight, rim, height_mm, float(radii_mm.min()))
    if hidden.sum() < LEAST_HIDDEN * near.sum():
        return np.zeros(len(radii_mm))
    parts = [np.maximum(shared @ (weight / weight.sum()), 0.0) for weight in (far, hidden)]
    return np.asarray(np.sqrt(parts[0] * parts[1]), np.float64)


def _behind_wall(sight: Sight, rim: Circle, height_mm: float, radius_mm: float) -> MaskArray:
    """(ARCS,) whether both cameras see a circle's arc through the wall, clear of the rim."""
    middle = rim.ring(radius_mm, height_mm, 2 * ARCS)[1::2]
    apart = [rim_crossing_mm(sight, rim, middle, view) for view in (0, 1)]
    return np.minimum(*apart) > rim.radius_mm + CLEAR_MM
