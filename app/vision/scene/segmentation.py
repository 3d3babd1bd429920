"""Which pixels are food, and which food: dishes from above, food by heights and colour, touching foods told apart.

The rectified first view with its points, hints -> one mask per food on the same grid. Dishes, shadows, the sheet,
cutlery and napkins are not food.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.masks import (
    components,
    dilated,
    distance_px,
    opened,
    touching,
    without_specks,
)
from app.vision.geometry.topview import TableTrend
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.by_colour import lay_out_by_colour, places_by_colour, with_plain_dishes
from app.vision.scene.dish import Dish
from app.vision.scene.filled_vessel import BOWL_ASPECT, FilledVessel
from app.vision.scene.food_checks import MIN_AREA_MM2, is_food
from app.vision.scene.food_outline import correct_outlines, tidy_outlines
from app.vision.scene.food_pixels import FLAT_MM, find_food_pixels
from app.vision.scene.foods_apart import tell_apart
from app.vision.scene.gaps import hole_by_colour
from app.vision.scene.hinted import hinted_masks
from app.vision.scene.layout import Layout, dish_under, lay_out, reduced_scene, without_heights
from app.vision.scene.places import Place, find_places, left_over
from app.vision.scene.scene import Scene
from app.vision.scene.support import (
    MIN_POINTS,
    Support,
    find_support,
    measured_support,
    with_measured_rim,
)
from app.vision.scene.upright_sides import with_sides
from app.vision.scene.vessel import Vessel, describe_vessel
from app.vision.tuning import COLOUR_TUNING
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair

LOW_RIM_MM = 5.0  # lower than any dish's over its table
BLACK_LEVEL = 4  # grey levels: black, and what JPEG makes of it
CANVAS_WIDTH_PX = 9  # of the rectified grid: a window of the finest disparity
# of a dish's outline within a region, or within a person's box or polygon: they are one
DISH_SHARE = 0.8
# of a region beyond what hints point at, from which on it is another food than theirs
OTHER_FOOD_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Region:
    """One food's mask on the rectified grid, (H, W), the hint that it answers, what it rests on and what it lies in.

    support: None where nothing was measured at all. vessel: the bowl that holds it, else None.
    liquid: the filled vessel whose liquid it is, else None. is_unread: a vessel in which no liquid's surface is seen.
    is_by_colour: no height shows it; it is a food only if a form that stands explains it.
    """

    mask: MaskArray
    hint: int | None = None
    support: Support | None = None
    vessel: Vessel | None = None
    liquid: FilledVessel | None = None
    is_unread: bool = False
    is_by_colour: bool = False


@dataclass(frozen=True, slots=True)
class Foods:
    """The foods of a meal, the table they stand on, which has no part of any dish, and the dishes that heights show."""

    regions: list[Region]
    table: TableTrend
    dishes: tuple[Dish, ...] = ()

    @property
    def mask(self) -> MaskArray:
        """(H, W) all of them."""
        return np.asarray(np.any([region.mask for region in self.regions], axis=0), np.bool_)


def rim_radii_mm(foods: Foods) -> dict[str, list[float]]:
    """Return kind -> radii of the rims of round dishes, mm: "plate", "bowl", and "cup" for one that holds a liquid."""
    radii: dict[str, list[float]] = {}
    for dish in foods.dishes:
        if dish.radius_mm is not None:
            radii.setdefault("bowl" if dish.is_deep else "plate", []).append(dish.radius_mm)
    for liquid in (region.liquid for region in foods.regions if region.liquid is not None):
        is_cup = liquid.rim.height_mm - liquid.table_mm > BOWL_ASPECT * liquid.rim.radius_mm
        radii.setdefault("cup" if is_cup else "bowl", []).append(liquid.rim.radius_mm)
    return {name: [round(float(each), 1) for each in found] for name, found in radii.items()}


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
    vessels: MaskArray | None = None,
    *,
    is_complete: bool = False,
    is_table_sure: bool = True,
    has_judge: bool = False,
) -> Foods | Failure:
    """Foods in the order of their size, those of hints first, then what colours alone show.

    points_table: (H, W, 3) mm, NaN. ignored: (H, W) marker sheet and what is not seen. vessels: (H, W) those that are
    measured by themselves. is_complete: only what the hints point at is returned. is_table_sure: a marker lies on it;
    otherwise the plane was found in the scene, and may be a dish's. has_judge: what colours alone show is added
    to the foods of a pair, for forms to tell whether it stands. Failure "no_food_found".
    """
    canvas = _canvas(pair)
    unseen = canvas | ~pair.is_seen
    ignored = ignored | canvas | (False if vessels is None else vessels)
    drawn = [Region(hint.mask, hint.index) for hint in hints if hint.is_exact]
    sought = [hint for hint in hints if not hint.is_exact]
    taken = ignored.copy()
    for region in drawn:
        taken |= region.mask
    measured, trend = reduced_scene(pair, disparity, points_table, ignored)

    def find(layout: Layout) -> Foods:
        dishes = [dish for dish in layout.dishes if not _is_hinted_food(dish, layout, hints)]
        layout = replace(layout, dishes=dishes)
        seen: list[Region] = []
        if sought or not is_complete:
            around = replace(
                layout, scene=replace(layout.scene, is_ignored=_reduced(taken, measured))
            )
            seen = _find_foods(around, sought, _reduced(unseen, measured), is_complete=is_complete)
        seen = [
            replace(region, mask=_enlarged(region.mask, pair.shape) & ~taken) for region in seen
        ]
        regions = _supported([region for region in drawn + seen if region.mask.any()], layout)
        return Foods(regions, layout.trend, tuple(dishes))

    layout = lay_out(measured, trend) if pair.second_bgr is not None else None
    layout = None if layout is None else with_plain_dishes(layout)
    foods = find(layout) if layout is not None else Foods(drawn, trend)
    if pair.second_bgr is not None and (is_table_sure or (layout is not None and layout.dishes)):
        if layout is not None and has_judge and not is_complete:
            beside = _by_colour_beside(foods, layout, _reduced(unseen, measured), pair.shape)
            foods = replace(foods, regions=[*foods.regions, *beside])
        return foods if foods.regions else no_food_found()
    foods = _by_colour(foods, measured, find, is_pair=pair.second_bgr is not None)
    return foods if foods.regions else no_food_found()


def _by_colour(
    foods: Foods, measured: Scene, find: Callable[[Layout], Foods], *, is_pair: bool
) -> Foods:
    """The foods where heights show no dish: of a single view, and of a pair whose table is too plain to be measured.

    foods: those that heights show. What a pair takes for its table may be the plane of a dish's rim; then foods and
    floor of that dish may be one region of heights beside the plane.
    """
    layout = lay_out_by_colour(without_heights(measured), foods.table)
    if is_pair:
        layout = _with_measured_rims(layout, measured)
    low = [dish for dish in layout.dishes if dish.rim_mm < LOW_RIM_MM]
    if not foods.regions or any(
        _is_dish(region, dish, layout) for region in foods.regions for dish in low
    ):
        foods = find(layout)
        standing = [
            region
            for region in foods.regions
            if region.hint is not None or _may_stand(region, measured)
        ]
        foods = replace(foods, regions=standing)
    elif low:
        foods = replace(foods, regions=_supported(foods.regions, layout))
    else:
        return foods
    if not np.isfinite(measured.height_mm).any():
        return foods
    return replace(foods, regions=_on_measured_support(foods.regions, measured, foods.table))


def _by_colour_beside(
    foods: Foods, layout: Layout, is_unseen: MaskArray, shape: tuple[int, int]
) -> list[Region]:
    """Return what colours show where heights show no food: smooth food, or a shadow.

    is_unseen: (h, w) as _find_foods has it
    shape: of the whole grid
    """
    scene = layout.scene
    is_food_by_heights = np.zeros_like(is_unseen)
    if foods.regions:
        is_food_by_heights = dilated(_reduced(foods.mask, scene), 3)
    taken = scene.is_ignored | is_food_by_heights
    unmeasured = opened(~np.isfinite(scene.height_mm) & ~taken, COLOUR_TUNING.unmeasured_px)
    unmeasured = without_specks(unmeasured, MIN_AREA_MM2 / scene.pixel_mm**2)
    if not unmeasured.any():
        return []
    plain = without_heights(scene)
    of_colours = replace(layout, scene=plain)
    if not layout.dishes:
        of_colours = _with_measured_rims(lay_out_by_colour(plain, layout.trend), scene)
    around = replace(plain, is_ignored=taken)
    masks: list[MaskArray] = []
    for place in places_by_colour(of_colours, [], unmeasured):
        new = opened(place.is_sure & ~is_food_by_heights, COLOUR_TUNING.unmeasured_px)
        parts = [
            part
            for part in components(new)
            if (part & unmeasured).any() and _may_stand_high(part, taken, scene)
        ]
        is_bowl = place.dish is not None and place.dish.is_deep  # whose content has no form
        if parts and not is_bowl:
            sure = np.any(parts, axis=0)
            seen = _in_place(around, replace(place, is_sure=sure), is_unseen, is_hinted=False)
            own = [each.mask for each in seen]
            if place.is_measured:
                beside = replace(scene, is_ignored=taken | place.is_elsewhere)
                own = with_sides(own, beside, place.floor_mm)
            masks += [_without_hole(mask, taken, scene) for mask in own]
    regions = [Region(_enlarged(mask, shape) & ~foods.mask, is_by_colour=True) for mask in masks]
    regions = [region for region in regions if region.mask.any()]
    return _supported(regions, replace(of_colours, scene=scene), is_food_by_heights)


def _with_measured_rims(layout: Layout, scene: Scene) -> Layout:
    """Return the layout with rims as high as they are measured, where they are. scene: with heights."""
    dishes = [with_measured_rim(dish, layout.view, scene) or dish for dish in layout.dishes]
    return replace(layout, dishes=dishes)


def _may_stand_high(part: MaskArray, taken: MaskArray, scene: Scene) -> bool:
    """Return False if the heights of a part and around it, (h, w), are too low for a food."""
    around = dilated(part, COLOUR_TUNING.around_px) & ~taken
    return _reaches(around, scene, COLOUR_TUNING.top_quantile, COLOUR_TUNING.low_mm)


def _canvas(pair: RectifiedPair) -> MaskArray:
    """(H, W) black that reaches the border of what is seen: a canvas around a turned photograph, or nothing lit.

    Widened by a window of the disparity, which sees the canvas's edge as if something stood there.
    """
    is_black = opened(
        cv2.inRange(pair.first_bgr, (0, 0, 0), (BLACK_LEVEL,) * 3) > 0, CANVAS_WIDTH_PX
    )
    unseen = np.pad(~pair.is_seen[1:-1, 1:-1], 1, constant_values=True)
    canvas = touching(is_black, dilated(unseen, 3))
    canvas &= pair.is_seen
    return distance_px(canvas) < CANVAS_WIDTH_PX


def _supported(
    regions: Sequence[Region], layout: Layout, others: MaskArray | None = None
) -> list[Region]:
    """The regions with what each of them rests on and lies in. others: (h, w) further foods."""
    masks = [_reduced(region.mask, layout.scene) for region in regions]
    none = np.zeros(layout.scene.is_ignored.shape, np.bool_)
    foods = np.any([none if others is None else others, *masks], axis=0)
    return [
        replace(
            region,
            support=find_support(layout.scene, layout.view, dish, layout.trend, mask, foods),
            vessel=describe_vessel(layout.scene, layout.view, dish, layout.trend),
        )
        for region, mask in zip(regions, masks, strict=True)
        if mask.any()
        for dish in (dish_under(mask, layout),)
    ]


def _on_measured_support(
    regions: Sequence[Region], scene: Scene, trend: TableTrend
) -> list[Region]:
    """The regions of a single view, with what its depth map shows of the support around each. scene: with heights."""
    masks = [_reduced(region.mask, scene) for region in regions]
    foods = np.any(masks, axis=0) if masks else np.zeros(scene.is_ignored.shape, np.bool_)
    return [
        region
        if region.support is None
        else replace(region, support=measured_support(region.support, scene, trend, mask, foods))
        for region, mask in zip(regions, masks, strict=True)
    ]


def _may_stand(region: Region, scene: Scene) -> bool:
    """Return False if the measured heights of a region lie flat: an empty board is no food."""
    return _reaches(_reduced(region.mask, scene), scene, 0.5, FLAT_MM)


def _reaches(where: MaskArray, scene: Scene, quantile: float, height_mm: float) -> bool:
    """Return whether a quantile of the heights in a mask (h, w) is over a height, or few are known."""
    heights = scene.height_mm[where & np.isfinite(scene.height_mm)]
    return len(heights) < MIN_POINTS or float(np.quantile(heights, quantile)) > height_mm


def _is_hinted_food(dish: Dish, layout: Layout, hints: Sequence[HintMask]) -> bool:
    """Whether a box or polygon is drawn around all of a dish: then it is the food, or its pack, that looks like one."""
    drawn = [
        hint.mask for hint in hints if (hint.is_exact or hint.is_box) and not hint.is_in_vessel
    ]
    return any(_covers(mask, dish, layout) for mask in drawn)


def _is_dish(region: Region, dish: Dish, layout: Layout) -> bool:
    """Return whether a region that nobody points at covers all of a dish."""
    return region.hint is None and _covers(region.mask, dish, layout)


def _covers(mask: MaskArray, dish: Dish, layout: Layout) -> bool:
    silhouette = dish.inward_at(layout.view, layout.scene.xy_at(dish.rim_mm)) > 0
    shared = np.count_nonzero(silhouette & _reduced(mask, layout.scene))
    return bool(shared > DISH_SHARE * np.count_nonzero(silhouette))


def _find_foods(
    layout: Layout, hints: Sequence[HintMask], is_unseen: MaskArray, *, is_complete: bool
) -> list[Region]:
    """Foods on the scene's grid: those that hints point at, and unless they are all, the others.

    is_unseen: (h, w), unlike what other foods hide or the sheet.
    """
    scene = layout.scene
    drawn = [_reduced(hint.mask, scene) for hint in hints]
    points = [mask for mask, hint in zip(drawn, hints, strict=True) if not hint.is_box]
    has_heights = bool(np.isfinite(scene.height_mm).any())
    places = (
        find_places(scene, layout.dishes, layout.view, points)
        if has_heights
        else places_by_colour(layout, points)
    )
    seen: list[_Seen] = []
    taken = scene.is_ignored
    for first in places:
        place: Place | None = first
        while place is not None:
            around = replace(scene, is_ignored=taken)
            own = _in_place(around, place, is_unseen, is_hinted=bool(hints))
            for each in own:
                taken = taken | each.mask
            seen += own
            place = left_over(place, taken, scene) if own else None
    masks = hinted_masks(
        drawn, [hint.is_box for hint in hints], [each.mask for each in seen], scene, places
    )
    if not has_heights:
        taken = np.any([taken, *masks], axis=0)
        seen = [replace(each, mask=_without_hole(each.mask, taken, scene)) for each in seen]
        masks = [_without_hole(mask, taken, scene) for mask in masks]
    hinted = [
        Region(mask, hint.index) for mask, hint in zip(masks, hints, strict=True) if mask.any()
    ]
    others = [] if is_complete else _others(seen, [region.mask for region in hinted])
    return hinted + sorted(others, key=lambda region: -int(np.count_nonzero(region.mask)))


def _without_hole(mask: MaskArray, taken: MaskArray, scene: Scene) -> MaskArray:
    """(h, w) the mask of a food without the hole that it may have. taken: all foods and what is ignored."""
    return mask & ~hole_by_colour(mask, taken & ~mask, scene.image_bgr) if mask.any() else mask


def _others(seen: Sequence["_Seen"], answered: Sequence[MaskArray]) -> list[Region]:
    """The foods that no hint points at. answered: (h, w) masks of those that one does."""
    taken = np.any(answered, axis=0) if answered else np.False_
    rests = [(each.mask & ~taken, np.count_nonzero(each.mask)) for each in seen if each.is_food]
    return [
        Region(rest) for rest, area in rests if np.count_nonzero(rest) > OTHER_FOOD_SHARE * area
    ]


@dataclass(frozen=True, slots=True)
class _Seen:
    """What was seen, (h, w). is_food: whether it is large, solid and raised enough to be a food that nobody names."""

    mask: MaskArray
    is_food: bool


def _in_place(scene: Scene, place: Place, is_unseen: MaskArray, *, is_hinted: bool) -> list[_Seen]:
    """The foods of one place, and where there are hints also what only a person would take for one."""
    food = find_food_pixels(scene, place)
    beside = replace(scene, is_ignored=scene.is_ignored | place.is_elsewhere)
    # A gap stays in it, for foods are told apart by their outer outlines.
    whole = tidy_outlines(food.is_food, beside, place.floor_mm) | (food.is_food & food.is_gap)
    masks = tell_apart(whole, scene, place.floor_mm)
    if place.is_measured:
        masks = with_sides(masks, beside, place.floor_mm)
    are_foods = [is_food(mask, food.is_core, scene, is_unseen) for mask in masks]
    if not is_hinted:
        masks, are_foods = list(compress(masks, are_foods)), [True] * sum(are_foods)
    # Gaps are opened only now, and stay open: each outline alone knows less of them than all heights did.
    masks = [mask & ~food.is_gap for mask in masks]
    beside = replace(beside, is_ignored=beside.is_ignored | food.is_gap)
    corrected = correct_outlines(masks, beside, place.floor_mm)
    return [
        _Seen(mask, is_kept)
        for mask, is_kept in zip(corrected, are_foods, strict=True)
        if mask.any()
    ]


def no_food_found() -> Failure:
    """The failure where nothing stands on the support."""
    return Failure(
        "no_food_found",
        "Nothing that stands out from the table or plate could be found.",
        "Photograph the meal at a slant of about 45 degrees with the whole plate in both views, or mark the food.",
    )


def _reduced(mask: MaskArray, scene: Scene) -> MaskArray:
    """A mask of the full grid on the scene's; any part of it counts, for a point may be small."""
    height, width = scene.is_ignored.shape
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.25


def _enlarged(mask: MaskArray, shape: tuple[int, int]) -> MaskArray:
    """The mask on the full grid, its stairs smoothed; the grids' borders agree."""
    field = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    return cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) > 0.5
