"""Which pixels are food, and which food: dishes from above, food by heights and colour, touching foods told apart.

The rectified first view with its points, hints -> one mask per food on the same grid. Dishes, shadows, the sheet,
cutlery and napkins are not food.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.errors import Failure
from app.vision.colour_bins import fine_texture
from app.vision.dish import Dish, find_dishes, solid_cells
from app.vision.disparity import DisparityMap
from app.vision.filled_vessel import FilledVessel
from app.vision.food_outline import correct_outlines
from app.vision.food_pixels import find_food_pixels
from app.vision.foods_apart import tell_apart
from app.vision.hinted import hinted_masks
from app.vision.model import Float32Array, MaskArray
from app.vision.places import Place, find_places
from app.vision.rectification import RectifiedPair
from app.vision.scene import IS_TABLE, Scene
from app.vision.support import Support, find_support
from app.vision.topview import TableTrend, TopView, fit_table_trend, usable_points, view_from_above
from app.vision.upright_sides import with_sides
from app.vision.vessel import Vessel, describe_vessel

REDUCTION = 2  # of the rectified grid, on which foods are found; outlines are carried back by a smooth field
LOWEST_MM = -30.0  # below the table: strays
CLEAR_OF_DISH_MM = 10.0  # beyond its outline, where the table is seen
MIN_AREA_MM2 = 250.0  # seen from above the camera: smaller than a cherry tomato is clutter
MIN_SOLIDITY = 0.5  # a mask that fills less of its convex hull is a rim or an arc of it
MIN_CORE_MM2 = 40.0  # of a mask that geometry alone calls food
MIN_THICKNESS_MM = 10.0  # of a mask at its widest
TABLE_WINDOW_PX = 15
TABLE_TEXTURE = 4.0  # grey levels, standard deviation in a window, from which on the views can be compared
MIN_TEXTURED_SHARE = 0.15  # of a mask
CUTLERY_ASPECT = 0.3  # width over length of knives, forks and spoons
MIRROR_MM, GREY_CHROMA = 25.0, 5.0  # height and chroma of a spoon's bowl
MIRROR_BLUR = 0.1  # of correlation, which a mirrored room costs
TABLE_THING_MM = 14.0  # over the table, as which cutlery and a telephone are measured
HINTED_DISH_SHARE = 0.8  # of a dish's outline within a person's box or polygon: what looks like a dish is the food
MAX_BORDER_SHARE = 0.15  # of its outline on the border of what is seen: the rest of it is unknown, or it is a wall


@dataclass(frozen=True, slots=True)
class Region:
    """One food's mask on the rectified grid, (H, W), the hint that it answers, what it rests on and what it lies in.

    support: None where nothing was measured at all. vessel: the bowl that holds it, else None.
    liquid: the filled vessel whose liquid it is, else None. is_unread: a vessel in which no liquid's surface is seen.
    """

    mask: MaskArray
    hint: int | None = None
    support: Support | None = None
    vessel: Vessel | None = None
    liquid: FilledVessel | None = None
    is_unread: bool = False


@dataclass(frozen=True, slots=True)
class Foods:
    """The foods of a meal, and the table they stand on, which has no part of any dish."""

    regions: list[Region]
    table: TableTrend

    @property
    def mask(self) -> MaskArray:
        """(H, W) all of them."""
        return np.asarray(np.any([region.mask for region in self.regions], axis=0), np.bool_)


@dataclass(frozen=True, slots=True)
class HintMask:
    """A hint drawn on the rectified grid. index: into the hints. is_exact: the mask is the food (polygon).

    is_box: the food lies within the mask; otherwise the mask (a point) lies within the food. is_in_vessel: it fills a
    vessel, as a person says.
    """

    mask: MaskArray
    index: int
    is_exact: bool = False
    is_box: bool = False
    is_in_vessel: bool = False


def segment_foods(
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    ignored: MaskArray,
    hints: Sequence[HintMask] = (),
) -> Foods | Failure:
    """Foods in the order of their size, those of hints first.

    points_table: (H, W, 3) mm, NaN. ignored: (H, W) marker sheet and what is not seen. With hints only what they point
    at is returned. Failure "no_food_found".
    """
    drawn = [Region(hint.mask, hint.index) for hint in hints if hint.is_exact]
    sought = [hint for hint in hints if not hint.is_exact]
    taken = ignored.copy()
    for region in drawn:
        taken |= region.mask
    scene, trend = _reduced_scene(pair, disparity, points_table, ignored)
    layout = _lay_out(scene, trend)
    if layout is None:
        return Foods(drawn, trend) if drawn else no_food_found()
    layout = replace(layout, dishes=[dish for dish in layout.dishes if not _is_hinted_food(dish, layout, hints)])
    found: list[Region] = []
    if sought or not hints:
        found = _found(replace(layout, scene=replace(layout.scene, is_ignored=_reduced(taken, scene))), sought)
    found = [replace(region, mask=_enlarged(region.mask, pair.shape) & ~taken) for region in found]
    regions = _supported([region for region in drawn + found if region.mask.any()], layout)
    return Foods(regions, layout.trend) if regions else no_food_found()


def _supported(regions: Sequence[Region], layout: "_Layout") -> list[Region]:
    """The regions with what each of them rests on and lies in."""
    masks = [_reduced(region.mask, layout.scene) for region in regions]
    foods = np.any(masks, axis=0) if masks else np.zeros(layout.scene.is_ignored.shape, np.bool_)
    return [
        replace(
            region,
            support=find_support(layout.scene, layout.view, dish, layout.trend, mask, foods),
            vessel=describe_vessel(layout.scene, layout.view, dish, layout.trend),
        )
        for region, mask in zip(regions, masks, strict=True)
        if mask.any()
        for dish in (_dish_under(mask, layout),)
    ]


def _dish_under(mask: MaskArray, layout: "_Layout") -> Dish | None:
    """The dish over which most of what a mask shows lies; None for the table."""
    shares = [
        float(
            (
                dish.inward_at(layout.view, layout.scene.points_table[..., :2])[mask & _is_measured(layout.scene)] > 0
            ).mean()
        )
        if (mask & _is_measured(layout.scene)).any()
        else float((dish.inward_at(layout.view, layout.scene.xy_at(dish.rim_mm))[mask] > 0).mean())
        for dish in layout.dishes
    ]
    if not shares or max(shares) < 0.5:
        return None
    return layout.dishes[int(np.argmax(shares))]


def _is_measured(scene: Scene) -> MaskArray:
    return np.isfinite(scene.points_table[..., 2])


def _is_hinted_food(dish: Dish, layout: "_Layout", hints: Sequence[HintMask]) -> bool:
    """Whether a box or polygon is drawn around all of a dish: then it is the food, or its pack, that looks like one."""
    silhouette = dish.inward_at(layout.view, layout.scene.xy_at(dish.rim_mm)) > 0
    drawn = [hint.mask for hint in hints if (hint.is_exact or hint.is_box) and not hint.is_in_vessel]
    area = np.count_nonzero(silhouette)
    return any(np.count_nonzero(silhouette & _reduced(mask, layout.scene)) > HINTED_DISH_SHARE * area for mask in drawn)


def _found(layout: "_Layout", hints: Sequence[HintMask]) -> list[Region]:
    """Foods on the scene's grid: those that hints point at, or all."""
    scene = layout.scene
    drawn = [_reduced(hint.mask, scene) for hint in hints]
    points = [mask for mask, hint in zip(drawn, hints, strict=True) if not hint.is_box]
    places = find_places(scene, layout.dishes, layout.view, points)
    regions: list[Region] = []
    taken = scene.is_ignored
    for place in places:
        own = _in_place(replace(scene, is_ignored=taken), place, is_hinted=bool(hints))
        for region in own:
            taken = taken | region.mask
        regions += own
    if not hints:
        return sorted(regions, key=lambda region: -int(np.count_nonzero(region.mask)))
    masks = hinted_masks(drawn, [hint.is_box for hint in hints], [region.mask for region in regions], scene, places)
    return [Region(mask, hint.index) for mask, hint in zip(masks, hints, strict=True) if mask.any()]


def _in_place(scene: Scene, place: Place, *, is_hinted: bool) -> list[Region]:
    """The foods of one place."""
    food = find_food_pixels(scene, place)
    beside = replace(scene, is_ignored=scene.is_ignored | place.is_elsewhere)
    masks = tell_apart(food.is_food, scene, place.floor_mm)
    if place.is_measured:
        masks = with_sides(masks, beside, place.floor_mm)
    if not is_hinted:
        masks = [mask for mask in masks if _is_food(mask, food.is_core, scene)]
    # Gaps are opened only now, and stay open: each outline alone knows less of them than all heights did.
    masks = [mask & ~food.is_gap for mask in masks]
    beside = replace(beside, is_ignored=beside.is_ignored | food.is_gap)
    return [Region(mask) for mask in correct_outlines(masks, beside, place.floor_mm) if mask.any()]


def no_food_found() -> Failure:
    """The failure where nothing stands on the support."""
    return Failure(
        "no_food_found",
        "Nothing that stands out from the table or plate could be found beside the marker.",
        "Photograph the meal at a slant of about 45 degrees with the whole plate in both views, or mark the food.",
    )


def _reduced_scene(
    pair: RectifiedPair, disparity: DisparityMap, points_table: Float32Array, ignored: MaskArray
) -> tuple[Scene, TableTrend]:
    every = slice(None, None, REDUCTION)
    points = np.ascontiguousarray(points_table[every, every])
    is_ignored = np.ascontiguousarray(ignored[every, every])
    height, width = is_ignored.shape
    trend = fit_table_trend(points[usable_points(points, is_ignored)])
    return (
        Scene(
            image_bgr=np.asarray(cv2.resize(pair.first_bgr, (width, height), interpolation=cv2.INTER_AREA), np.uint8),
            height_mm=(points[..., 2] - trend.height_mm(points[..., :2])).astype(np.float32),
            points_table=points,
            reach_px=np.ascontiguousarray(disparity.reach_px[every, every]) / np.float32(REDUCTION),
            is_ignored=is_ignored,
            plane_xy_mm=_plane_xy(pair),
            camera_mm=pair.first_centre_mm,
            pixel_mm=REDUCTION * pair.pixel_mm,
            texture=np.ascontiguousarray(fine_texture(pair.first_bgr)[every, every]),
            table_correlation=np.ascontiguousarray(_table_correlation(pair)[every, every]),
        ),
        trend,
    )


def _table_correlation(pair: RectifiedPair) -> Float32Array:
    """(H, W) normalised cross correlation of both views at parallax zero, the marker's plane; NaN where it is plain."""
    first, second = (
        np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float32) for image in (pair.first_bgr, pair.second_bgr)
    )
    window = (TABLE_WINDOW_PX, TABLE_WINDOW_PX)
    mean, mean_second = cv2.boxFilter(first, -1, window), cv2.boxFilter(second, -1, window)
    variance = cv2.boxFilter(first * first, -1, window) - mean * mean
    variance_second = cv2.boxFilter(second * second, -1, window) - mean_second * mean_second
    covariance = cv2.boxFilter(first * second, -1, window) - mean * mean_second
    correlation = covariance / np.sqrt(np.maximum(variance, 1.0) * np.maximum(variance_second, 1.0))
    return np.where(variance > TABLE_TEXTURE**2, correlation, np.float32(np.nan)).astype(np.float32)


def _plane_xy(pair: RectifiedPair) -> Float32Array:
    """(h, w, 2) where the rays of the reduced grid meet the marker's plane, mm; far away above the horizon."""
    height, width = pair.shape
    u = ((np.arange(0, width, REDUCTION) - pair.centre_px[0]) / pair.focal_px).astype(np.float32)
    v = ((np.arange(0, height, REDUCTION) - pair.centre_px[1]) / pair.focal_px).astype(np.float32)
    x, y, z = (row[0] * u[None, :] + row[1] * v[:, None] + row[2] for row in pair.rotation.T.astype(np.float32))
    reach = np.float32(pair.first_centre_mm[2]) / np.maximum(-z, np.float32(1e-3))
    centre = pair.first_centre_mm.astype(np.float32)
    return np.asarray(np.stack([centre[0] + reach * x, centre[1] + reach * y], axis=-1), np.float32)


@dataclass(frozen=True, slots=True)
class _Layout:
    """The scene with heights over a table that no dish has a part in, seen from above, and its dishes."""

    scene: Scene
    trend: TableTrend
    view: TopView
    dishes: list[Dish]


def _lay_out(scene: Scene, trend: TableTrend) -> _Layout | None:
    """None where nothing was measured."""
    usable = usable_points(scene.points_table, scene.is_ignored)
    raised = usable & (np.nan_to_num(scene.height_mm) > LOWEST_MM)
    view = view_from_above(scene.points_table[raised], scene.height_mm[raised])
    if view is None:
        return None
    dishes = find_dishes(view, solid_cells(view, 1.0 / scene.pixel_mm**2), trend.noise_mm, np.random.default_rng(0))
    if not dishes:
        return _Layout(scene, trend, view, dishes)
    inward = np.max([dish.inward_at(view, scene.points_table[..., :2]) for dish in dishes], axis=0)
    better = fit_table_trend(scene.points_table[usable & (inward < -CLEAR_OF_DISH_MM)])
    height = scene.points_table[..., 2] - better.height_mm(scene.points_table[..., :2])
    lifted = [_lifted(dish, view, trend, better) for dish in dishes]
    return _Layout(replace(scene, height_mm=height.astype(np.float32)), better, view, lifted)


def _lifted(dish: Dish, view: TopView, trend: TableTrend, better: TableTrend) -> Dish:
    """The dish with its heights over the better table."""
    middle = view.centres_mm()[dish.inward_mm > 0].mean(axis=0)
    step = float(trend.height_mm(middle) - better.height_mm(middle))
    floor_mm = max(dish.floor_mm + step, 0.0) if dish.floor_mm > 0 else 0.0
    return replace(dish, rim_mm=max(dish.rim_mm + step, 1.0), floor_mm=floor_mm)


def _is_food(mask: MaskArray, is_core: MaskArray, scene: Scene) -> bool:
    """Whether a mask is large, solid, raised and whole enough to be a food rather than a rim, a wall or clutter."""
    square_mm = scene.pixel_mm**2
    if np.count_nonzero(mask) * square_mm < MIN_AREA_MM2 or np.count_nonzero(mask & is_core) * square_mm < MIN_CORE_MM2:
        return False
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    if 2 * float(depth.max()) * scene.pixel_mm < MIN_THICKNESS_MM or _solidity(mask) < MIN_SOLIDITY:
        return False
    if _is_table_thing(mask, 2 * float(depth.max()), scene):
        return False
    outline = mask & (depth <= 1.5)
    seen = np.pad(~scene.is_ignored[1:-1, 1:-1], 1).astype(np.uint8)
    at_border = cv2.erode(seen, np.ones((5, 5), np.uint8)) == 0
    return bool(np.count_nonzero(outline & at_border) <= MAX_BORDER_SHARE * np.count_nonzero(outline))


def _is_table_thing(mask: MaskArray, width_px: float, scene: Scene) -> bool:
    """Whether a mask is low and either long as cutlery or no more than the table, on whose plane both views agree.

    Cutlery mirrors the room and a telephone shows its edges alone, so that their heights are some millimetres wrong;
    the bowl of a spoon, which is grey, by some more.
    """
    heights = scene.height_mm[mask]
    heights = heights[np.isfinite(heights)]
    top_mm = float(np.quantile(heights, 0.9)) if len(heights) else 0.0
    if top_mm > MIRROR_MM or (top_mm > TABLE_THING_MM and not _is_grey(mask, scene)):
        return False
    _, sides, _ = cv2.minAreaRect(np.argwhere(mask)[:, ::-1].astype(np.float32))
    if top_mm <= TABLE_THING_MM and width_px < CUTLERY_ASPECT * max(sides):
        return True
    correlation = scene.table_correlation[mask]
    correlation = correlation[np.isfinite(correlation)]
    is_textured = len(correlation) > MIN_TEXTURED_SHARE * np.count_nonzero(mask)
    return bool(is_textured and np.median(correlation) > IS_TABLE - MIRROR_BLUR * (top_mm > TABLE_THING_MM))


def _is_grey(mask: MaskArray, scene: Scene) -> bool:
    lab = cv2.cvtColor(np.ascontiguousarray(scene.image_bgr[mask][None]), cv2.COLOR_BGR2LAB)[0].astype(np.float32)
    return bool(np.median(np.hypot(lab[:, 1] - 128.0, lab[:, 2] - 128.0)) < GREY_CHROMA)


def _solidity(mask: MaskArray) -> float:
    """Share of its outline's convex hull that the mask fills; a rim, even a closed one, fills little."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = float(cv2.contourArea(cv2.convexHull(max(contours, key=len))))
    return np.count_nonzero(mask) / hull if hull > 0 else 0.0


def _reduced(mask: MaskArray, scene: Scene) -> MaskArray:
    """A mask of the full grid on the scene's; any part of it counts, for a point may be small."""
    height, width = scene.is_ignored.shape
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.25


def _enlarged(mask: MaskArray, shape: tuple[int, int]) -> MaskArray:
    """The mask on the full grid, its stairs smoothed; the grids' borders agree."""
    field = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    return cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) > 0.5
