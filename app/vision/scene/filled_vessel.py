"""Liquids in vessels: rim, surface and what is known of the inside below it -> millilitres and their doubt.

Both views -> one FilledVessel for each vessel whose liquid's surface is seen. The surface's own circle is the inside at
that height; below it the inside is the library's, or what vessels of that shape are like.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy

from app.core.units import ml_from_mm3
from app.vision.geometry.masks import eroded
from app.vision.geometry.mesh import ClosedShape
from app.vision.geometry.pictures import LabPicture
from app.vision.geometry.slices import Slice, disc, turned
from app.vision.geometry.topview import TableTrend
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.scene.glass_level import find_level_in_glass
from app.vision.scene.liquid_level import Level, find_level, visible
from app.vision.scene.rims import FINE_SD_PX, Circle, find_circles, smoothed_pair
from app.vision.scene.sectors import sector_of
from app.vision.vessel_library import VesselModel
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight

LEAST_RIM_MM = 25.0  # over the table: lower rims are plates'
COAXIAL_MM = 5.0  # circles of one vessel; one along two edges of a thick rim lies farther off
# Height by radius of the rim: deep plates at the first, bowls and cups between the next two, mugs and glasses at the
# last; and the inside's radius at the floor by that at the surface. Plates have a flat well, mugs an upright wall.
ASPECTS = (0.4, 0.6, 1.4, 2.0)
FOOT_SHARES = (0.78, 0.55, 0.55, 0.92)
FOOT_SHARE_SDS = (0.1, 0.12, 0.12, 0.05)
# glasses taper evenly, by some two degrees, to a rounded base
GLASS_FOOT_SHARE, GLASS_POWER = (0.88, 0.05), 0.9
UPRIGHT = ASPECTS[-1]
# Of the inside's curve: a cone has 1, a cylinder 0. A plate's flat well turns up in a quarter of an ellipse, 0.27.
POWERS, POWER_SD = (0.3, 0.45, 0.45, 0.45), 0.16
# Of the inside over the table: a plate's floor is as thick as its wall; others have a foot ring or a thick base.
FLOORS_MM, FLOOR_SD_MM = (3.5, 5.0, 5.0, 5.0), 1.2
FLOOR_OF_TALL_MM = FLOORS_MM[-1]
UPRIGHT_LEAST_SHARE = 0.8  # of the rim's radius that an upright vessel's surface has
HEAP_MM = 4.0  # over the surface's edge: what is measured higher is heaped food, no liquid
ROUGH_MM = 6.0  # half the height between the surface's 10 and 90 %: food on a plate, no soup
BOWL_ASPECT = 1.0  # height by radius of the rim: in narrower vessels windows of the dense match reach the wall
HEAP_SHARE = 0.3  # of the surface that must be measured to say so
# of the library's inside radius in the circle found, which may be the wall's outer edge
RIM_INSET_MM = (-1.5, 6.0)
# within which a library vessel's rim must lie: poses scale heights
RIM_HEIGHT_MM, RIM_HEIGHT_SHARE = 5.0, 0.05
# of a library vessel's level: a lip is round, and which of its lines is the brim differs
MODEL_SD_MM = 1.0
STEP_MM, SLICE_MM = 0.5, 4.0
MAX_RELATIVE_SD = 0.25  # of the content: more, and no volume is given
DISC_POINTS = 200
OPEN_ASPECT, OPEN_COVER = 1.0, 0.65  # height by radius and cover of an upright vessel's rim
# what may be measured at the rim's height within it
OPEN_INSET_MM, OPEN_TOP_MM, OPEN_TOP_SHARE = 4.0, 6.0, 0.15
# a rim seen so well may be brimful; of what lies within one that is not, the share that a solid's top has
SURE_COVER, TOP_SHARE = 0.7, 0.5
OPEN_FOOT_SHARE = 0.85  # of the rim's radius
FLOOR_OF_GLASS = 0.9  # of the surface's radius: glasses taper a little
# outside a rim, where a vessel's wall falls to the table
BESIDE_MM, BESIDE_LEVEL_MM = (4.0, 20.0), 8.0
# sectors around a vessel, and the share in which the surface goes on at its height
SECTORS, PRINT_SECTORS = 16, 0.75
WINDOW_MM, WINDOW_PX = 5.0, 4  # around a vessel, where the colours beside its surface are taken
EDGE_PX = 21  # from the surface's outline, where windows of the dense match lie across the rim


@dataclass(frozen=True, slots=True)
class Inside:
    """profile_mm: (n, 2) radius and height over the table, from the floor up."""

    profile_mm: Float64Array

    def volume_ml(self, level_mm: float) -> float:
        """Volume between the floor and a level over the table; the uppermost radius is carried on."""
        floor = float(self.profile_mm[0, 1])
        depth = max(level_mm - floor, 0.0)
        steps = max(int(np.ceil(depth / STEP_MM)), 1)
        heights = floor + (np.arange(steps) + 0.5) * depth / steps
        return ml_from_mm3(float(np.pi * np.square(self.radius_mm(heights)).sum() * depth / steps))

    def radius_mm(self, height_mm: Float64Array | float) -> Float64Array:
        """Radius at a height over the table."""
        return np.asarray(
            np.interp(height_mm, self.profile_mm[:, 1], self.profile_mm[:, 0]), np.float64
        )


@dataclass(frozen=True, slots=True)
class LiquidVolume:
    """volume_ml, sd_ml, and its form: slices and closed shape, z from the inside floor. library: the vessel's name."""

    volume_ml: float
    sd_ml: float
    floor_mm: float
    slices: tuple[Slice, ...]
    shape: ClosedShape
    library: str | None = None

    @property
    def is_measurable(self) -> bool:
        """Whether the doubt leaves a volume worth telling."""
        return self.sd_ml < MAX_RELATIVE_SD * self.volume_ml


@dataclass(frozen=True, slots=True)
class StandingVessel:
    """silhouette: (H, W) the whole vessel in the first view. rim, table_mm: the table's height there.

    Heights count from the marker's plane.
    """

    silhouette: MaskArray
    rim: Circle
    table_mm: float


@dataclass(frozen=True, slots=True)
class FilledVessel(StandingVessel):
    """A vessel with its liquid. content: (H, W) the surface as far as it is seen; level as the rim."""

    content: MaskArray
    level: Level
    liquid: LiquidVolume

    @property
    def flags(self) -> tuple[str, ...]:
        """Stable codes of the item."""
        if not self.liquid.is_measurable:
            return ("not_measurable",)
        return ("vessel_library",) if self.liquid.library is not None else ("inside_guessed",)

    def measured_as(self, model: VesselModel) -> "FilledVessel":
        """The same vessel, its liquid measured by a library vessel that a person named."""
        liquid = measure_liquid(self.rim, self.level, self.table_mm, model=model)
        return self if liquid is None else replace(self, liquid=liquid)

    def surface_points(self) -> Float64Array:
        """(n, 3) mm over the table, evenly on the liquid's surface."""
        turn = np.arange(DISC_POINTS) * np.pi * (3.0 - np.sqrt(5.0))
        reach = self.level.radius_mm * np.sqrt((np.arange(DISC_POINTS) + 0.5) / DISC_POINTS)
        x, y = self.rim.centre_mm
        height = np.full(DISC_POINTS, self.level.height_mm - self.table_mm)
        return np.column_stack([x + reach * np.cos(turn), y + reach * np.sin(turn), height])


@dataclass(frozen=True, slots=True)
class Vessels:
    """filled: those whose liquid's surface is seen. unread: others, empty or with clear water."""

    filled: list[FilledVessel]
    unread: list[StandingVessel]


def find_vessels(
    pair: RectifiedPair,
    points_table: Float32Array,
    table: TableTrend,
    ignored: MaskArray,
    library: Sequence[VesselModel] = (),
) -> Vessels:
    """Vessels by their rims. points_table: (H, W, 3) mm, NaN. ignored: (H, W) sheet, unseen."""
    sight = Sight(pair)
    circles = find_circles(pair, sight, ~ignored)
    if not circles:
        return Vessels([], [])
    first_bgr, second_bgr = pair.both_bgr
    pictures = LabPicture(first_bgr), LabPicture(second_bgr)
    grey = smoothed_pair(pair, FINE_SD_PX)
    vessels: list[FilledVessel] = []
    unread: list[StandingVessel] = []
    rims: list[Circle] = []  # of vessels filled or seen to be open
    for rim in circles:
        table_mm = float(table.height_mm(rim.centre_mm))
        if (
            rim.height_mm - table_mm < LEAST_RIM_MM
            or _is_within(rim, rims)
            or _is_surface(rim, circles)
            or _is_print(rim, points_table)
            or _has_top(rim, points_table)
        ):
            continue
        first_lab, second_lab = (
            picture.within(_window(sight, rim, table_mm, view))
            for view, picture in enumerate(pictures)
        )
        lab = first_lab, second_lab
        is_upright = rim.height_mm - table_mm > OPEN_ASPECT * rim.radius_mm
        level = find_level_in_glass(sight, lab, rim, table_mm) if is_upright else None
        level = level or find_level(sight, lab, grey, rim, table_mm)
        if level is not None and not _is_plausible(rim, level, table_mm):
            level = None
        if level is None:
            if is_upright and _is_open(rim, points_table):
                rims.append(rim)
                silhouette = _silhouette(sight, rim, rim.radius_mm * OPEN_FOOT_SHARE, table_mm)
                unread.append(StandingVessel(silhouette, rim, table_mm))
            continue
        silhouette, content = _masks(sight, rim, level, table_mm)
        if _is_heaped(points_table, content, rim, level, table_mm):
            continue
        liquid = measure_liquid(rim, level, table_mm, library)
        if liquid is not None:
            rims.append(rim)
            vessels.append(FilledVessel(silhouette, rim, table_mm, content, level, liquid))
    return Vessels(vessels, unread)


def measure_liquid(
    rim: Circle,
    level: Level,
    table_mm: float,
    library: Sequence[VesselModel] = (),
    model: VesselModel | None = None,
) -> LiquidVolume | None:
    """The liquid's volume; None if the surface lies too low.

    By the model, else by the library's vessel that has this rim, else by what vessels are like.
    """
    model = model or recognise(rim, table_mm, library)
    if model is not None:
        # Errors of the poses lift rim and surface alike; the depth below the rim is surer than the height.
        height = model.height_mm - (rim.height_mm - level.height_mm)
        inside = inside_of_model(model)
        height_sd = float(np.hypot(level.sd_mm[0], MODEL_SD_MM))
        volume = inside.volume_ml(height)
        changes = [
            0.5 * (inside.volume_ml(height + height_sd) - inside.volume_ml(height - height_sd))
        ]
    else:
        height = level.height_mm - table_mm
        aspect = (rim.height_mm - table_mm) / rim.radius_mm
        floor, foot, foot_sd, power = (
            float(np.interp(aspect, ASPECTS, each))
            for each in (FLOORS_MM, FOOT_SHARES, FOOT_SHARE_SDS, POWERS)
        )
        if level.is_in_glass:
            (foot, foot_sd), power = GLASS_FOOT_SHARE, GLASS_POWER
        means = np.array([height, level.radius_mm, floor, foot, power])
        height_sd = float(np.hypot(level.sd_mm[0], level.lift_sd_mm))
        spreads = np.array([height_sd, level.sd_mm[1], FLOOR_SD_MM, foot_sd, POWER_SD])
        inside = _usual_inside(*means.tolist())
        volume = inside.volume_ml(height)
        changes = []
        for place, spread in enumerate(spreads):
            low, high = means.copy(), means.copy()
            low[place] -= spread
            high[place] += spread
            changes.append(0.5 * (_usual_volume(*high.tolist()) - _usual_volume(*low.tolist())))
    floor_mm = float(inside.profile_mm[0, 1])
    if volume <= 0.0 or height - floor_mm < 1.0:
        return None
    return LiquidVolume(
        volume,
        float(np.sqrt(np.square(changes).sum())),
        floor_mm,
        *_form(rim.centre_mm, inside, height),
        library=None if model is None else model.name,
    )


def recognise(rim: Circle, table_mm: float, library: Sequence[VesselModel]) -> VesselModel | None:
    """The library's vessel whose rim fits best in radius and height; None if none does."""
    height_mm = rim.height_mm - table_mm
    scored = []
    for model in library:
        inset = rim.radius_mm - model.rim_diameter_mm / 2
        lift = height_mm - model.height_mm
        if (
            RIM_INSET_MM[0] < inset < RIM_INSET_MM[1]
            and abs(lift) < RIM_HEIGHT_MM + RIM_HEIGHT_SHARE * model.height_mm
        ):
            scored.append((float(np.hypot(inset - 1.5, lift)), model))
    return min(scored, key=lambda each: each[0])[1] if scored else None


def inside_of_model(model: VesselModel) -> Inside:
    """A library vessel's inside: its profile, or a frustum of its capacity."""
    if model.inside_profile_mm:
        return Inside(np.array(model.inside_profile_mm, np.float64))
    radius, floor = model.rim_diameter_mm / 2, min(FLOOR_OF_TALL_MM, 0.2 * model.height_mm)

    def frustum(foot: float) -> Inside:
        heights = np.linspace(floor, model.height_mm, 40)
        return Inside(np.column_stack([np.linspace(foot, radius, 40), heights]))

    capacity = model.capacity_ml or 0.0

    def excess(foot: float) -> float:
        return frustum(foot).volume_ml(model.height_mm) - capacity

    low, high = 0.05 * radius, 2.0 * radius  # a jug may be wider below
    if excess(low) * excess(high) > 0:
        return frustum(low if excess(low) > 0 else high)
    return frustum(float(scipy.optimize.brentq(excess, low, high)))


def _usual_inside(
    level_mm: float, radius_mm: float, floor_mm: float, foot: float, power: float
) -> Inside:
    """Return the inside of radius (foot + (1 - foot) u^power), u the share of the way from floor to surface."""
    share = np.linspace(0.0, 1.0, 60)
    radii = radius_mm * (foot + (1 - foot) * share**power)
    floor = min(floor_mm, level_mm - 1.0)
    return Inside(np.column_stack([radii, floor + share * (level_mm - floor)]))


def _usual_volume(
    level_mm: float, radius_mm: float, floor_mm: float, foot: float, power: float
) -> float:
    return _usual_inside(level_mm, radius_mm, floor_mm, min(foot, 1.0), power).volume_ml(level_mm)


def _form(
    centre_mm: Float64Array, inside: Inside, level_mm: float
) -> tuple[tuple[Slice, ...], ClosedShape]:
    """Slices and closed shape of what is filled up to the level over the table; heights from the inside floor."""
    floor_mm = float(inside.profile_mm[0, 1])
    depth = level_mm - floor_mm
    slices = []
    for low in np.arange(0.0, depth, SLICE_MM).tolist():
        high = min(low + SLICE_MM, depth)
        radius = max(float(inside.radius_mm(floor_mm + (low + high) / 2)), 1.0)
        slices.append(disc(low, high, centre_mm, radius))
    rings = np.linspace(0.0, depth, max(int(np.ceil(depth)), 2) + 1)
    return tuple(slices), turned(
        centre_mm, np.maximum(inside.radius_mm(floor_mm + rings), 0.1), rings, 0.0
    )


def _is_within(circle: Circle, rims: Sequence[Circle]) -> bool:
    """Whether the circle belongs to a vessel already judged."""
    return any(np.linalg.norm(circle.centre_mm - rim.centre_mm) < rim.radius_mm for rim in rims)


def _is_surface(circle: Circle, circles: Sequence[Circle]) -> bool:
    """Whether another circle about the same axis lies higher: that one is the rim."""
    return any(
        np.linalg.norm(circle.centre_mm - other.centre_mm) < COAXIAL_MM
        and other.height_mm > circle.height_mm + 6.0
        and other.radius_mm > 0.9 * circle.radius_mm
        for other in circles
    )


def _is_plausible(rim: Circle, level: Level, table_mm: float) -> bool:
    """Whether an upright vessel would have a surface as wide."""
    is_upright = rim.height_mm - table_mm > UPRIGHT * rim.radius_mm
    return not is_upright or level.radius_mm > UPRIGHT_LEAST_SHARE * rim.radius_mm


def _is_heaped(
    points_table: Float32Array, content: MaskArray, rim: Circle, level: Level, table_mm: float
) -> bool:
    """Whether what fills a bowl is measured to be no level surface. A mirror image only lies below it."""
    if rim.height_mm - table_mm > BOWL_ASPECT * rim.radius_mm:
        return False
    inner = eroded(content, EDGE_PX)
    heights = points_table[..., 2][inner]
    measured = heights[np.isfinite(heights)]
    if len(measured) < max(HEAP_SHARE * len(heights), 100):
        return False
    low, middle, high = np.quantile(measured, (0.1, 0.5, 0.9))
    return bool(middle - level.height_mm > HEAP_MM or (high - low) / 2 > ROUGH_MM)


def _is_print(rim: Circle, points_table: Float32Array) -> bool:
    """Return whether the surface outside is as high as the rim: a circle printed on a pack, the hole of a cake."""
    points = _points_near(rim, points_table, BESIDE_MM[1])
    apart = points[:, :2] - rim.centre_mm
    beyond = np.linalg.norm(apart, axis=-1) - rim.radius_mm
    around = (beyond > BESIDE_MM[0]) & (beyond < BESIDE_MM[1])
    sector = sector_of(apart[around, 0], apart[around, 1], SECTORS)
    is_as_high = points[around, 2] > rim.height_mm - BESIDE_LEVEL_MM
    measured, high = (
        np.bincount(sector[chosen], minlength=SECTORS) for chosen in (slice(None), is_as_high)
    )
    return float(np.mean((high > 0) & (high > 0.5 * measured))) > PRINT_SECTORS


def _is_open(rim: Circle, points_table: Float32Array) -> bool:
    """Return whether nothing within the rim lies at its height, as the top of a cake or a tin would."""
    if rim.cover < OPEN_COVER:
        return False
    heights = _heights_within(rim, points_table)
    return (
        len(heights) == 0
        or float(np.mean(np.abs(heights - rim.height_mm) < OPEN_TOP_MM)) < OPEN_TOP_SHARE
    )


def _has_top(rim: Circle, points_table: Float32Array) -> bool:
    """Return whether most of what lies within a doubtful rim is as high: an apple's highlight is a circle, too."""
    if rim.cover >= SURE_COVER:
        return False
    heights = _heights_within(rim, points_table)
    return len(heights) > 0 and float(np.mean(heights > rim.height_mm - OPEN_TOP_MM)) > TOP_SHARE


def _heights_within(rim: Circle, points_table: Float32Array) -> Float32Array:
    """Return the heights (n,), mm, of what is measured within the rim, clear of its wall."""
    points = _points_near(rim, points_table)
    apart = np.linalg.norm(points[:, :2] - rim.centre_mm, axis=-1)
    return np.asarray(points[apart < rim.radius_mm - OPEN_INSET_MM, 2], np.float32)


def _points_near(rim: Circle, points_table: Float32Array, beyond_mm: float = 0.0) -> Float32Array:
    """Return the points (n, 3) within a square about the rim that extends beyond_mm past it."""
    low, high = (rim.centre_mm + side * (rim.radius_mm + beyond_mm + 1.0) for side in (-1, 1))
    x, y = points_table[..., 0], points_table[..., 1]
    return np.asarray(
        points_table[(x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])], np.float32
    )


def _silhouette(sight: Sight, rim: Circle, foot_mm: float, table_mm: float) -> MaskArray:
    """(H, W) the hull of a rim and its foot on the table, in the first view."""
    return _hull(sight, rim.ring(rim.radius_mm, rim.height_mm), rim.ring(foot_mm, table_mm))


def _window(sight: Sight, rim: Circle, table_mm: float, view: int) -> tuple[slice, slice]:
    """Rows and columns that hold all circles about a rim's axis, no wider than it, down to the table."""
    rings = np.vstack(
        [rim.ring(rim.radius_mm + WINDOW_MM, height) for height in (rim.height_mm, table_mm)]
    )
    pixels = sight.in_view(*sight.project(rings), view)
    sides = []
    for low, high, size in zip(
        pixels.min(axis=0)[::-1], pixels.max(axis=0)[::-1], sight.pair.shape, strict=True
    ):
        first = int(np.clip(np.floor(low) - WINDOW_PX, 0, size - 1))
        sides.append(slice(first, int(np.clip(np.ceil(high) + WINDOW_PX, first + 1, size))))
    return sides[0], sides[1]


def _masks(sight: Sight, rim: Circle, level: Level, table_mm: float) -> tuple[MaskArray, MaskArray]:
    """(H, W) the whole vessel, and its liquid, both in the first view.

    Of the liquid the surface as far as an opaque rim leaves it in view; in a glass all below the surface as well.
    """
    surface = rim.ring(level.radius_mm, level.height_mm)
    silhouette = _silhouette(sight, rim, min(level.radius_mm, rim.radius_mm), table_mm)
    if level.is_in_glass:
        floor = rim.ring(FLOOR_OF_GLASS * level.radius_mm, table_mm + FLOOR_OF_TALL_MM)
        return silhouette, _hull(sight, surface, floor)
    content = _filled(sight.project(surface)[0], sight.pair.shape)
    if visible(sight, rim, surface, 0).mean() < 1.0:
        content &= _filled(
            sight.project(rim.ring(rim.radius_mm, rim.height_mm))[0], sight.pair.shape
        )
    return silhouette, content


def _hull(sight: Sight, *rings: Float64Array) -> MaskArray:
    """(H, W) the hull of circles (n, 3) in the first view."""
    pixels = np.vstack([sight.project(ring)[0] for ring in rings]).astype(np.float32)
    return _filled(cv2.convexHull(pixels).reshape(-1, 2), sight.pair.shape)


def _filled(ring: cv2.typing.MatLike, shape: tuple[int, int]) -> MaskArray:
    canvas = np.zeros(shape, np.uint8)
    cv2.fillPoly(canvas, [np.rint(ring).astype(np.int32)], (1.0,))
    return canvas > 0
