"""Which families a food may belong to, each begun from its measured points: ball, lying, bent, heap, slab, ring.

Points of the visible side (mm, table frame), the area of its mask and the support -> forms to fit (forms.py).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float64Array
from app.vision.solids.forms import (
    BEND,
    E1,
    E2,
    HEAP_SD,
    REST_SD,
    SPREAD,
    SUNK,
    SUPPORT,
    TAPER,
    TURN_X,
    TURN_Z,
    A,
    B,
    C,
    Form,
    Ring,
    Superellipsoid,
    X,
    Y,
)

UPPER_SHARE = 0.7  # of the height, above which a slab's top lies
SLAB_LOG_EXPONENT = -1.2  # rounded edges of a third of a half-axis
BENT_RAD = 0.6  # each half, where a bent form begins
RING_TUBE_SHARE = 0.45  # of the outer radius
MIN_HALF_MM = 4.0
MAX_ASPECT = 5.0
TOP_QUANTILE = 0.99
BEHIND_SHARE = 0.4  # of the smaller of radius and half height, by which the middle lies behind the visible points'
ROUND = ("ball", "lying", "bent")  # families whose section across C is
STRAY_SHARE = 3.0  # of the radius: points farther from the middle are not the food's
MIN_POINTS = 50

_PLACE = (X, Y, SUPPORT, A, B, C, E1, E2, *range(TURN_X, TURN_Z + 1))
_UPRIGHT = (*_PLACE, TAPER)
_BENT = (*_PLACE, TAPER, BEND)
_HEAP = (X, Y, SUPPORT, SUNK, A, B, C, E1, E2, TURN_Z)
_SLAB = _PLACE
_RING = (X, Y, SUPPORT, A, B, C, E1, TURN_X, TURN_X + 1, TURN_Z)


def families(
    points_table: Float64Array,
    mask_mm2: float,
    support_mm: float,
    support_sd_mm: float,
    camera_mm: Float64Array,
) -> list[Form]:
    """Forms to try. points_table: (n, 3) of the food. mask_mm2: its mask's area, as if seen at the support.

    support_mm, support_sd_mm: height of what it rests on. camera_mm: (3,). Empty where too little is measured.
    """
    points = points_table[points_table[:, 2] > support_mm - 2 * support_sd_mm]
    if len(points) < MIN_POINTS:
        return []
    middle = np.median(points[:, :2], axis=0)
    radius = float(np.sqrt(mask_mm2 / np.pi))
    points = points[np.linalg.norm(points[:, :2] - middle, axis=1) < STRAY_SHARE * radius]
    if len(points) < MIN_POINTS:
        return []
    height = max(float(np.quantile(points[:, 2], TOP_QUANTILE)) - support_mm, 2 * MIN_HALF_MM)
    variance, axes = np.linalg.eigh(np.cov((points[:, :2] - middle).T))
    aspect = min(float(np.sqrt(variance[1] / max(variance[0], 1e-6))), MAX_ASPECT)
    away = middle - camera_mm[:2]
    away /= max(float(np.linalg.norm(away)), 1e-9)
    upper = points[points[:, 2] - support_mm > UPPER_SHARE * height, :2]
    extent = Extent(
        middle + away * BEHIND_SHARE * min(radius, height / 2),
        radius,
        aspect,
        float(np.arctan2(axes[1, 1], axes[0, 1])),
        height,
        _rectangle(upper) if len(upper) >= MIN_POINTS else None,
    )
    return begin_families(extent, support_mm, support_sd_mm)


@dataclass(frozen=True, slots=True)
class Rectangle:
    """middle_mm: (2,). half_mm: its two half sides; heading of the first, radians."""

    middle_mm: Float64Array
    half_mm: tuple[float, float]
    heading: float


@dataclass(frozen=True, slots=True)
class Extent:
    """How far a food reaches. middle_mm: (2,) x, y. radius_mm: of a disc that covers as much of the table.

    aspect: length by width. heading: of the length, radians. height_mm: over the support. top: a flat top's, if any.
    """

    middle_mm: Float64Array
    radius_mm: float
    aspect: float
    heading: float
    height_mm: float
    top: Rectangle | None


def begin_families(extent: Extent, support_mm: float, support_sd_mm: float) -> list[Form]:
    """Each family with this extent; the slab only where there is a top."""
    radius, height = extent.radius_mm, extent.height_mm
    long, short = radius * np.sqrt(extent.aspect), radius / np.sqrt(extent.aspect)
    place = _placed(extent.middle_mm, support_mm)
    upright = _turned(extent.heading)
    # C along, A across, B up
    lying = upright @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def form(
        name: str, free: tuple[int, ...], axes: Float64Array, **values: float
    ) -> Superellipsoid:
        p = place.copy()
        for key, value in values.items():
            p[_KEYS[key]] = value
        rest_sd = HEAP_SD if name == "heap" else REST_SD
        return Superellipsoid(
            name, p, free, axes, support_sd_mm, rest_sd=rest_sd, is_round=name in ROUND
        )

    half = np.log(height / 2)
    forms: list[Form] = [
        form("ball", _UPRIGHT, upright, a=np.log(long), b=np.log(short), c=half),
        form("lying", _UPRIGHT, lying, a=np.log(short), b=half, c=np.log(long)),
        form(
            "heap", _HEAP, upright, a=np.log(long), b=np.log(short), c=np.log(height), sunk=height
        ),
    ]
    bent = {"a": np.log(0.9 * short), "b": half, "c": np.log(1.1 * long)}
    forms += [form("bent", _BENT, lying, bend=side * BENT_RAD, **bent) for side in (-1, 1)]
    if extent.top is not None:
        a, b = (np.log(max(side, MIN_HALF_MM)) for side in extent.top.half_mm)
        x, y = extent.top.middle_mm.tolist()
        slab = {"x": x, "y": y, "e1": SLAB_LOG_EXPONENT, "e2": SLAB_LOG_EXPONENT}
        forms.append(form("slab", _SLAB, _turned(extent.top.heading), a=a, b=b, c=half, **slab))
    tube = min(height / 2, RING_TUBE_SHARE * radius)
    p = place.copy()
    p[[A, B, C]] = np.log([max(radius - tube, MIN_HALF_MM), tube, tube])
    forms.append(Ring("ring", p, _RING, upright, support_sd_mm))
    return forms


def _rectangle(points: Float64Array) -> Rectangle:
    """The smallest one around (n, 2) points."""
    centre, size, angle = cv2.minAreaRect(points.astype(np.float32))
    return Rectangle(np.array(centre), (size[0] / 2, size[1] / 2), float(np.radians(angle)))


_KEYS = {"x": X, "y": Y, "a": A, "b": B, "c": C, "e1": E1, "e2": E2, "sunk": SUNK, "bend": BEND}


def _placed(xy_mm: Float64Array, support_mm: float) -> Float64Array:
    p = np.zeros(len(SPREAD))
    p[[X, Y]], p[SUPPORT] = xy_mm, support_mm
    return p


def _turned(heading: float) -> Float64Array:
    """(3, 3) turn about z."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
