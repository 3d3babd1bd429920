"""Which pixels are food, and which food: dish from above, all food by heights and colour, touching foods told apart.

The rectified first view with its points, hints -> a mask a food on the same grid. Dishes, shadows, the sheet and what
lies beside the dish are not food.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.errors import Failure
from app.vision.dish import Dish, find_dish, solid_cells
from app.vision.disparity import DisparityMap
from app.vision.filled_vessel import FilledVessel
from app.vision.food_outline import correct_outlines
from app.vision.food_pixels import Scene, find_food_pixels, fine_texture
from app.vision.foods_apart import divide, tell_apart
from app.vision.model import Float32Array, MaskArray
from app.vision.rectification import RectifiedPair
from app.vision.support import Support, find_support
from app.vision.topview import TableTrend, TopView, fit_table_trend, usable_points, view_from_above
from app.vision.vessel import Vessel, describe_vessel

REDUCTION = 2  # of the rectified grid, on which foods are found; outlines are carried back by a smooth field
LOWEST_MM = -30.0  # below the table: strays
CLEAR_OF_DISH_MM = 10.0  # beyond its outline, where the table is seen
MIN_AREA_MM2 = 250.0  # seen from above the camera: smaller than a cherry tomato is clutter
MIN_SOLIDITY = 0.5  # a mask that fills less of its convex hull is a rim or an arc of it
MIN_CORE_MM2 = 40.0  # of a mask that geometry alone calls food
MIN_THICKNESS_MM = 10.0  # of a mask at its widest
MIN_HINTED_MM = 3.0  # over the table: within a box in which nothing was found, higher is food
MAX_BORDER_SHARE = 0.15  # of its outline on the border of what is seen: the rest of it is unknown, or it is a wall


@dataclass(frozen=True, slots=True)
class Region:
    """One food's mask on the rectified grid, (H, W), the hint that it answers, what it rests on and what it lies in.

    support: None where nothing was measured at all. vessel: the bowl that holds it, else None.
    liquid: the filled vessel whose liquid it is, else None.
    """

    mask: MaskArray
    hint: int | None = None
    support: Support | None = None
    vessel: Vessel | None = None
    liquid: FilledVessel | None = None


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

    is_box: the food lies within the mask; otherwise the mask (a point) lies within the food.
    """

    mask: MaskArray
    index: int
    is_exact: bool = False
    is_box: bool = False


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
    view, dish = _seen_from_above(scene, trend)
    if view is not None and dish is not None:
        scene, trend, dish = _over_the_table_alone(scene, trend, view, dish)
    if view is None:
        return Foods(drawn, trend) if drawn else no_food_found()
    found: list[Region] = []
    if sought or not hints:
        found = _found(replace(scene, is_ignored=_reduced(taken, scene)), dish, view, sought)
    found = [replace(region, mask=_enlarged(region.mask, pair.shape) & ~taken) for region in found]
    regions = [region for region in drawn + found if region.mask.any()]
    vessel = describe_vessel(scene, view, dish, trend)
    small = [_reduced(region.mask, scene) for region in regions]
    foods = np.any(small, axis=0) if small else np.zeros(scene.is_ignored.shape, np.bool_)
    regions = [
        replace(region, support=find_support(scene, view, dish, trend, mask, foods), vessel=vessel)
        for region, mask in zip(regions, small, strict=True)
        if mask.any()
    ]
    return Foods(regions, trend) if regions else no_food_found()


def _found(scene: Scene, dish: Dish | None, view: TopView, hints: Sequence[HintMask]) -> list[Region]:
    """Foods on the scene's grid: those that hints point at, or all."""
    points = [_reduced(hint.mask, scene) for hint in hints if not hint.is_box]
    food = find_food_pixels(scene, dish, view, points)
    masks = tell_apart(food.is_food, scene)
    if hints:
        regions = _pointed_at(masks, hints, scene)
    else:
        regions = [Region(mask) for mask in masks if _is_food(mask, food.is_core, scene)]
        regions.sort(key=lambda region: -int(np.count_nonzero(region.mask)))
    # Gaps are opened only now, and stay open: each outline alone knows less of them than all heights did.
    masks = [region.mask & ~food.is_gap for region in regions]
    beside = replace(scene, is_ignored=scene.is_ignored | food.is_gap)
    corrected = correct_outlines(masks, beside, dish.floor_mm if dish else 0.0)
    return [replace(region, mask=mask) for region, mask in zip(regions, corrected, strict=True)]


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
        ),
        trend,
    )


def _plane_xy(pair: RectifiedPair) -> Float32Array:
    """(h, w, 2) where the rays of the reduced grid meet the marker's plane, mm; far away above the horizon."""
    height, width = pair.shape
    u = ((np.arange(0, width, REDUCTION) - pair.centre_px[0]) / pair.focal_px).astype(np.float32)
    v = ((np.arange(0, height, REDUCTION) - pair.centre_px[1]) / pair.focal_px).astype(np.float32)
    x, y, z = (row[0] * u[None, :] + row[1] * v[:, None] + row[2] for row in pair.rotation.T.astype(np.float32))
    reach = np.float32(pair.first_centre_mm[2]) / np.maximum(-z, np.float32(1e-3))
    centre = pair.first_centre_mm.astype(np.float32)
    return np.asarray(np.stack([centre[0] + reach * x, centre[1] + reach * y], axis=-1), np.float32)


def _seen_from_above(scene: Scene, trend: TableTrend) -> tuple[TopView | None, Dish | None]:
    usable = usable_points(scene.points_table, scene.is_ignored) & (np.nan_to_num(scene.height_mm) > LOWEST_MM)
    view = view_from_above(scene.points_table[usable], scene.height_mm[usable])
    if view is None:
        return None, None
    is_solid = solid_cells(view, 1.0 / scene.pixel_mm**2)
    return view, find_dish(view, is_solid, trend.noise_mm, np.random.default_rng(0))


def _over_the_table_alone(scene: Scene, trend: TableTrend, view: TopView, dish: Dish) -> tuple[Scene, TableTrend, Dish]:
    """Heights anew over a table whose trend the dish's floor has no part in."""
    usable = usable_points(scene.points_table, scene.is_ignored)
    inward = dish.inward_at(view, scene.points_table[..., :2])
    better = fit_table_trend(scene.points_table[usable & (inward < -CLEAR_OF_DISH_MM)])
    middle = view.centres_mm()[dish.inward_mm > 0].mean(axis=0)
    lifted = float(trend.height_mm(middle) - better.height_mm(middle))
    height = scene.points_table[..., 2] - better.height_mm(scene.points_table[..., :2])
    floor_mm = dish.floor_mm + lifted if dish.floor_mm > 0 else 0.0
    return (
        replace(scene, height_mm=height.astype(np.float32)),
        better,
        replace(dish, rim_mm=max(dish.rim_mm + lifted, 1.0), floor_mm=max(floor_mm, 0.0)),
    )


def _is_food(mask: MaskArray, is_core: MaskArray, scene: Scene) -> bool:
    """Whether a mask is large, solid, raised and whole enough to be a food rather than a rim, a wall or clutter."""
    square_mm = scene.pixel_mm**2
    if np.count_nonzero(mask) * square_mm < MIN_AREA_MM2 or np.count_nonzero(mask & is_core) * square_mm < MIN_CORE_MM2:
        return False
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    if 2 * float(depth.max()) * scene.pixel_mm < MIN_THICKNESS_MM or _solidity(mask) < MIN_SOLIDITY:
        return False
    outline = mask & (depth <= 1.5)
    seen = np.pad(~scene.is_ignored[1:-1, 1:-1], 1).astype(np.uint8)
    at_border = cv2.erode(seen, np.ones((5, 5), np.uint8)) == 0
    return bool(np.count_nonzero(outline & at_border) <= MAX_BORDER_SHARE * np.count_nonzero(outline))


def _solidity(mask: MaskArray) -> float:
    """Share of its outline's convex hull that the mask fills; a rim, even a closed one, fills little."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = float(cv2.contourArea(cv2.convexHull(max(contours, key=len))))
    return np.count_nonzero(mask) / hull if hull > 0 else 0.0


def _pointed_at(found: list[MaskArray], hints: Sequence[HintMask], scene: Scene) -> list[Region]:
    """For each hint the found mask that it overlaps most, cut to the hint's box.

    Several hints in one mask share it. A hint in which nothing was found gives what is raised in a box, or nothing.
    """
    drawn = [_reduced(hint.mask, scene) for hint in hints]
    chosen: dict[int, list[int]] = {}
    masks: dict[int, MaskArray] = {}
    for place, inside in enumerate(drawn):
        overlaps = [int(np.count_nonzero(mask & inside)) for mask in found]
        if overlaps and max(overlaps) > 0:
            chosen.setdefault(int(np.argmax(overlaps)), []).append(place)
        else:
            masks[place] = inside & (np.nan_to_num(scene.height_mm, nan=-1.0) > MIN_HINTED_MM)
    for which, places in chosen.items():
        shares = divide(found[which], [drawn[place] for place in places], scene) if len(places) > 1 else [found[which]]
        masks |= dict(zip(places, shares, strict=True))
    regions = []
    for place, hint in enumerate(hints):
        mask = masks[place] & drawn[place] if hint.is_box else masks[place]
        if mask.any():
            regions.append(Region(mask, hint.index))
    return regions


def _reduced(mask: MaskArray, scene: Scene) -> MaskArray:
    """A mask of the full grid on the scene's; any part of it counts, for a point may be small."""
    height, width = scene.is_ignored.shape
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.25


def _enlarged(mask: MaskArray, shape: tuple[int, int]) -> MaskArray:
    """The mask on the full grid, its stairs smoothed; the grids' borders agree."""
    field = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    return cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) > 0.5
