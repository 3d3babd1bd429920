"""Dishes and places of a single view, where no heights tell what stands: by what is unlike the surface it lies on.

The reduced picture over the table -> Layout and Places as heights give them for a pair. The table shows its colours
around the sheet and along the picture's border, a dish along its rim; what differs there and hangs together lies on
it. A thing that is round or rectangular as seen from above, larger than a slice of bread, and that shows another thing
within, is a dish.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.vision.geometry.ellipse import Ellipse, fit_ellipse
from app.vision.geometry.masks import (
    components,
    dilated,
    distance_px,
    inward_px,
    largest_part,
    opened,
    resized,
    touching,
    without_specks,
)
from app.vision.geometry.pictures import blurred, lab_bytes
from app.vision.geometry.topview import TableTrend, TopView
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.scene.colour_bins import (
    UNSEEN,
    byte_bins,
    colour_evidence,
    colour_histogram,
    contrast_features,
    shaded_bins,
)
from app.vision.scene.dish import Dish, inward_of
from app.vision.scene.floors import with_floor
from app.vision.scene.layout import Layout
from app.vision.scene.min_cut import cut_in_two, is_settled
from app.vision.scene.places import (
    OVER_RIM_MM,
    REACH_IN_DISH_MM,
    REACH_MM,
    RIM_BAND_MM,
    Place,
    groups_of,
)
from app.vision.scene.scene import Scene
from app.vision.scene.support import TYPICAL_BOARD_MM, TYPICAL_RIM_MM, with_measured_rim
from app.vision.scene.upright_sides import flat_top
from app.vision.tuning import COLOUR_TUNING

TABLE_REACH_MM = 480.0  # from the sheet: beyond lies the room
BORDER_SHARE = 0.05  # of the picture's sides: its border, which foods seldom reach
AROUND_SHEET_MM = (5.0, 25.0)  # beyond the paper, whose edge is blurred and may lie a little off
MIN_BARE_PX = 150
SIDE_PX = 360  # of the reduced picture
COMMON_SHARE = 0.02  # of the bare surface, whose rarest colours are left out of what it is like
ROUNDS = 3
LIGHT_ROUNDS, LIGHT_RIDGE = 4, 1e-4
LEAST_LIGHT_SPREAD = 1e-3  # of the log of a channel
GROWTHS = 5
ALIKE_SPREADS = 3.0
PLAIN_SHARE = 0.8  # of what is surely bare, that looks alike in the same light
LEAST_SPREAD, USUAL_SPREADS, APART_NATS = 1.0, 4.0, 4.0
MIN_THING_MM2 = 250.0
CELL_MM = 3.0
MIN_DISH_MM2 = 9000.0  # a saucer; smaller ones are foods
MAX_DISH_MM2 = 110_000.0
MAX_ASPECT = 1.6
ON_OUTLINE_MM = 3.5
MIN_ROUND_COVER, MIN_SQUARE_COVER = 0.55, 0.85  # of a dish's outline, which food may hide
SECTORS = 48
TRIALS = 300
OUTLINE_POINTS = 240
RIM_MM = (3.0, 16.0)  # inward, where a dish is bare
# inward from a dish's outline, up to which what differs is its decoration or its edge
BESIDE_RIM_MM = 8.0
SHARE_INSIDE = 0.4  # of what lies on a dish, that is seen within its rim
MAX_SHARE_ON_DISH = 0.75  # of a dish that what lies on it may hide


def lay_out_by_colour(scene: Scene, trend: TableTrend) -> Layout:
    """The layout of a scene without heights."""
    view, things = _top_grid(scene), _on_table(scene)
    dishes = [_as_dish(thing, scene, view) for thing in components(things)]
    return Layout(scene, trend, view, [dish for dish in dishes if dish is not None], things)


def places_by_colour(
    layout: Layout, points: Sequence[MaskArray], wanted: MaskArray | None = None
) -> list[Place]:
    """The places that hold food. points: (h, w) small parts that are food for certain.

    wanted: (h, w); dishes, and the table, without any of it are left out. None: nothing is.
    """
    scene = layout.scene
    nothing = np.zeros(scene.is_ignored.shape, np.bool_)
    silhouettes = [_silhouette(dish, layout) for dish in layout.dishes]
    things = layout.things & ~scene.is_ignored
    on_dishes = [
        _on_dish(scene, touching(things, silhouette), _inward(dish, layout))
        if wanted is None or (silhouette & wanted).any()
        else nothing
        for dish, silhouette in zip(layout.dishes, silhouettes, strict=True)
    ]
    taken = np.any([nothing, *silhouettes, *on_dishes], axis=0)
    on_table = without_specks(
        opened(things & ~dilated(taken, 5), 3), MIN_THING_MM2 / scene.pixel_mm**2
    )
    for point in points:
        at = point & ~scene.is_ignored
        owners = [
            number for number, silhouette in enumerate(silhouettes) if (silhouette & at).any()
        ]
        if owners:
            on_dishes[owners[0]] = on_dishes[owners[0]] | at
        elif not any((each & at).any() for each in on_dishes):
            on_table = on_table | at
    places = []
    for number, (dish, silhouette, sure) in enumerate(
        zip(layout.dishes, silhouettes, on_dishes, strict=True)
    ):
        if sure.any():
            others = [
                *silhouettes[:number],
                *silhouettes[number + 1 :],
                *on_dishes[:number],
                *on_dishes[number + 1 :],
            ]
            elsewhere = np.any([on_table, *others], axis=0) & ~sure
            reach = distance_px(sure) * scene.pixel_mm < REACH_IN_DISH_MM
            band = _band(_inward(dish, layout), RIM_BAND_MM) & ~sure
            places.append(Place(dish, sure, silhouette | reach, band, elsewhere))
    for group in groups_of(on_table, scene):
        elsewhere = (taken | (on_table & ~group)) & ~group
        near = distance_px(group) * scene.pixel_mm < REACH_MM
        places.append(Place(None, group, near, nothing, elsewhere))
    return places


def with_plain_dishes(layout: Layout) -> Layout:
    """Return the layout with its things, and with dishes whose rims are too plain for heights to show them."""
    things = _on_table(layout.scene)
    silhouettes = [_inward(dish, layout) > 0 for dish in layout.dishes]
    is_dish = np.any([np.zeros_like(things), *silhouettes], axis=0)
    dishes = list(layout.dishes)
    for thing in components(things):
        dish_px = np.count_nonzero(thing & is_dish)
        if dish_px >= COLOUR_TUNING.most_on_dishes * np.count_nonzero(thing):
            continue
        dish = _plain_dish(thing, layout)
        if dish is not None:
            dishes.append(dish)
    return replace(layout, dishes=dishes, things=things)


def _plain_dish(thing: MaskArray, layout: Layout) -> Dish | None:
    """Return the dish whose outline a thing has by its colour, with its measured rim; None for a food."""
    dish = _as_dish(thing, layout.scene, layout.view)
    if dish is None or flat_top(thing, layout.scene, 0.0) is not None:
        return None
    dish = with_measured_rim(dish, layout.view, layout.scene)
    low_mm, high_mm = COLOUR_TUNING.plain_rim_mm
    if dish is None or not low_mm < dish.rim_mm < high_mm:
        return None
    dish = with_floor(dish, layout.scene, layout.view, layout.trend)
    return dish if _holds_food(dish, layout) else None


def _holds_food(dish: Dish, layout: Layout) -> bool:
    """Return whether something stands in a dish, as nothing does on a printed pack."""
    scene = layout.scene
    standing = np.nan_to_num(scene.height_mm) > dish.rim_mm + OVER_RIM_MM
    standing &= _inward(dish, layout) > RIM_BAND_MM[1]
    return bool(np.count_nonzero(standing) * scene.pixel_mm**2 > MIN_THING_MM2)


def _on_table(scene: Scene) -> MaskArray:
    """(h, w) dishes and foods on the table."""
    return _unlike(scene, _bare_table(scene), _is_table(scene))


def _is_table(scene: Scene) -> MaskArray:
    """(h, w) whose rays meet the table near the sheet."""
    return (
        np.hypot(scene.plane_xy_mm[..., 0], scene.plane_xy_mm[..., 1]) < TABLE_REACH_MM
    ) & ~scene.is_ignored


def _bare_table(scene: Scene) -> MaskArray:
    """(h, w) that shows the bare table for the most part: around the sheet and along the picture's border."""
    height, width = scene.is_ignored.shape
    border = np.ones((height, width), np.bool_)
    margin = max(2, round(BORDER_SHARE * max(height, width)))
    border[margin:-margin, margin:-margin] = False
    sheet = scene.is_ignored & (
        np.hypot(scene.plane_xy_mm[..., 0], scene.plane_xy_mm[..., 1]) < TABLE_REACH_MM / 2
    )
    clear_mm = distance_px(sheet) * scene.pixel_mm
    around = clear_mm < AROUND_SHEET_MM[1]
    return (border | around) & (clear_mm > AROUND_SHEET_MM[0]) & _is_table(scene)


def _unlike(
    scene: Scene, bare: MaskArray, within: MaskArray, *, is_dish: bool = False
) -> MaskArray:
    """(h, w) what lies on a surface: unlike its bare part in colour, whole and filled. within: where it is sought.

    is_dish: the surface is one, on which what may be a shadow is left out.
    Reduced, for the cut takes long and the food's own outline is sought again.
    """
    height, width = bare.shape
    scale = min(1.0, SIDE_PX / max(height, width))
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    small_bare, small_within = (resized(mask, size) for mask in (bare, within))
    image = np.asarray(cv2.resize(scene.image_bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    things = _unlike_small(
        image,
        small_bare,
        small_within,
        MIN_THING_MM2 * (scale / scene.pixel_mm) ** 2,
        is_dish=is_dish,
    )
    whole = (
        cv2.resize(things.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    )
    return whole & within


def _unlike_small(
    image_bgr: ImageArray, bare: MaskArray, within: MaskArray, least: float, *, is_dish: bool
) -> MaskArray:
    """(h, w) the same of a reduced picture. least: area of a thing, px."""
    nothing = np.zeros(bare.shape, np.bool_)
    if np.count_nonzero(bare) < MIN_BARE_PX or not within.any():
        return nothing
    image, bare = _evenly_lit(image_bgr, bare, within)
    lab = lab_bytes(image)
    bins, shaded = byte_bins(image), shaded_bins(image)
    features = contrast_features(lab)
    # else the sheet's squares set what counts as contrast
    features[~within] = np.median(features[within], axis=0)
    own = colour_histogram([bins, *shaded], bare)[bins]
    common = float(np.quantile(own[bare], COMMON_SHARE))
    apart = _apart_nats(lab, bare)
    ratio = np.log((common + UNSEEN) / (own + UNSEEN)) + apart
    mask: MaskArray = within & ~bare & (ratio > 0)
    mask = without_specks(opened(mask, 3), least)

    def cut(apart: Float32Array, never: MaskArray, teaches_nothing: MaskArray) -> MaskArray:
        inner, outer = mask & (inward_px(mask, 3) > 2), (within | bare) & (distance_px(mask) > 3)
        inner &= ~teaches_nothing
        if not (inner.any() and outer.any()):
            return mask
        inside, outside = colour_histogram([bins], inner), colour_histogram([bins, *shaded], outer)
        ratio = colour_evidence(inside, outside)[bins] + apart
        again = cut_in_two(ratio.astype(np.float32), features, never, nothing)
        return without_specks(opened(again, 3), least)

    for _ in range(ROUNDS):
        before, mask = mask, cut(apart, ~within, nothing)
        if is_settled(mask, before):
            break
    if is_dish and mask.any():
        may_be_shadow = _may_be_shadow(lab, bare)
        shadows = _lesser_parts(mask, may_be_shadow)
        if shadows.any():
            unlike = np.where(may_be_shadow, np.float32(0.0), apart)
            mask = cut(unlike, ~(within & mask), shadows)
    return mask & within


def _lesser_parts(mask: MaskArray, may_be_shadow: MaskArray) -> MaskArray:
    """(h, w) what may be shadow of the parts of a mask that surely are something else for the most part."""
    lesser = np.zeros_like(mask)
    for part in components(mask):
        sure = part & ~may_be_shadow
        if np.count_nonzero(sure) > COLOUR_TUNING.sure_share * np.count_nonzero(part):
            lesser |= part & may_be_shadow
    return lesser


def _may_be_shadow(lab: Float32Array, bare: MaskArray) -> MaskArray:
    """(h, w) as a bare surface may look, lit or in a shadow that what stands beside it colours.

    lab: (h, w, 3), 0-255, evenly lit.
    """
    smooth = blurred(lab, 1.0)
    middle = np.median(smooth[bare], axis=0)
    off = smooth - middle
    spread = 1.48 * np.median(np.abs(off[bare]), axis=0) + LEAST_SPREAD
    lighter = np.maximum(off[..., 0], 0.0) / spread[0]
    darkness = np.clip(-off[..., :1] / middle[0], 0.0, 1.0)
    cast = off[..., 1:] / (spread[1:] + COLOUR_TUNING.cast * darkness)
    away = lighter**2 + (cast**2).sum(axis=-1)
    return np.asarray(away < USUAL_SPREADS**2, np.bool_)


def _apart_nats(lab: Float32Array, bare: MaskArray) -> Float32Array:
    """(h, w) what speaks against a bare surface beyond a histogram's bins: lighter, or of another chroma, than it is.

    Darker is what shadows are. lab: (h, w, 3), 0-255, evenly lit.
    """
    smooth = blurred(lab, 1.0)
    light = np.maximum(smooth[..., 0], 1.0)
    features = np.stack(
        [light, 128.0 * (smooth[..., 1] - 128.0) / light, 128.0 * (smooth[..., 2] - 128.0) / light],
        -1,
    )
    middle = np.median(features[bare], axis=0)
    spread = 1.48 * np.median(np.abs(features[bare] - middle), axis=0) + LEAST_SPREAD
    off = (features - middle) / spread
    off[..., 0] = np.maximum(off[..., 0], 0.0)
    beyond = np.maximum(np.sqrt((off**2).sum(axis=-1)) - USUAL_SPREADS, 0.0)
    return np.asarray(np.minimum(beyond, APART_NATS), np.float32)


def _evenly_lit(
    image_bgr: ImageArray, bare: MaskArray, within: MaskArray
) -> tuple[ImageArray, MaskArray]:
    """The picture as if a surface were lit alike all over, each channel over its slow course there; and its bare part.

    bare: (h, w) surely of the surface. From there the course is followed over what looks the same in the same light,
    within (h, w), so that it is not continued to where nothing is known of it; all of that is bare, unless the surface
    has a pattern, of which it would be a part.
    """
    height, width = bare.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    values = np.log(image_bgr.astype(np.float32) + 1.0)
    surface = bare
    for _ in range(GROWTHS):
        courses = np.stack(
            [_course(values[..., channel], design, surface) for channel in range(3)], axis=-1
        )
        off = np.abs(values - courses)
        spread = 1.48 * np.median(off[surface], axis=0) + LEAST_LIGHT_SPREAD
        alike = within & (off / spread < ALIKE_SPREADS).all(axis=-1)
        grown = touching(opened(alike, 3), surface)
        surface = grown | bare
    steady = values - courses + np.median(courses[surface], axis=0)
    is_plain = np.count_nonzero(grown & bare) > PLAIN_SHARE * np.count_nonzero(bare)
    return np.clip(np.exp(steady) - 1.0, 0, 255).astype(np.uint8), surface if is_plain else bare


def _course(values: Float32Array, design: Float32Array, where: MaskArray) -> Float32Array:
    """(h, w) the slow course of a channel, fitted where a surface shows (h, w), whatever else lies there."""
    pixels = np.flatnonzero(where)
    step = max(1, len(pixels) // COLOUR_TUNING.course_points)
    row, column = np.unravel_index(pixels[::step], where.shape)
    rows, seen = design[row, column], values[row, column]
    ridge = LIGHT_RIDGE * len(rows) * np.eye(rows.shape[1], dtype=np.float32)
    weights = np.ones_like(seen)
    for _ in range(LIGHT_ROUNDS):
        weighted = rows * weights[:, None]
        course = np.linalg.solve(weighted.T @ rows + ridge, weighted.T @ seen)
        off = np.abs(seen - rows @ course)
        weights = 1.0 / (1.0 + (off / (1.48 * np.median(off) + LEAST_LIGHT_SPREAD)) ** 2)
    return design @ course


def _top_grid(scene: Scene) -> TopView:
    """An empty view from above of what the picture shows of the table near the sheet."""
    xy = scene.plane_xy_mm[_is_table(scene)].astype(np.float64)
    low, high = (end(xy, axis=0) for end in (np.min, np.max)) if len(xy) else np.eye(2)
    columns, rows = (int(cells) for cells in np.ceil((high - low) / CELL_MM) + 1)
    shape = (rows, columns)
    return TopView(low, CELL_MM, np.zeros(shape, np.float32), np.zeros(shape, np.int64))


@dataclass(frozen=True, slots=True)
class _Outline:
    """inward_mm: (rows, columns) of the top view. cover: share of the outline that is seen."""

    inward_mm: Float32Array
    cover: float


def _as_dish(thing: MaskArray, scene: Scene, view: TopView) -> Dish | None:
    """The dish that a thing is; None for a food."""
    area_mm2 = np.count_nonzero(thing) * scene.pixel_mm**2
    if area_mm2 < MIN_DISH_MM2 / 2:
        return None
    outline = _outline_mm(thing, scene.xy_at(TYPICAL_RIM_MM))
    best: tuple[_Outline, bool] | None = None
    ellipse = _fit_ellipse(outline, view)
    if ellipse is not None and ellipse.cover > MIN_ROUND_COVER:
        best = ellipse, True
    else:
        rectangle = _fit_rectangle(outline, view)
        if rectangle is not None and rectangle.cover > MIN_SQUARE_COVER:
            best = rectangle, False
    if best is None:
        return None
    shape, is_round = best
    size_mm2 = np.count_nonzero(shape.inward_mm > 0) * view.cell_mm**2
    if not MIN_DISH_MM2 < size_mm2 < MAX_DISH_MM2:
        return None
    rim_mm = TYPICAL_RIM_MM if is_round else TYPICAL_BOARD_MM
    dish = Dish(shape.inward_mm, rim_mm, 0.0 if is_round else TYPICAL_BOARD_MM)
    inward = dish.inward_at(view, scene.xy_at(rim_mm))
    held = _on_dish(scene, thing, inward)
    share = np.count_nonzero(held) / max(int(np.count_nonzero(inward > 0)), 1)
    return dish if held.any() and share < MAX_SHARE_ON_DISH else None


def _outline_mm(thing: MaskArray, xy_mm: Float32Array) -> Float64Array:
    """(n, 2) mm of the outline, evenly drawn."""
    contours, _ = cv2.findContours(
        largest_part(thing).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    pixels = np.asarray(max(contours, key=len)).reshape(-1, 2)
    chosen = pixels[
        np.linspace(0, len(pixels) - 1, min(OUTLINE_POINTS, len(pixels))).astype(np.int64)
    ]
    return np.asarray(xy_mm[chosen[:, 1], chosen[:, 0]], np.float64)


def _fit_ellipse(outline: Float64Array, view: TopView) -> _Outline | None:
    """The ellipse that most of the outline lies on, which food that stands over the rim hides in part."""

    def may_be_dish(ellipse: Ellipse) -> bool:
        small, large = float(ellipse.half.min()), float(ellipse.half.max())
        return small >= ON_OUTLINE_MM and large < MAX_ASPECT * small

    def cover(ellipse: Ellipse) -> float:
        return _cover(outline, ellipse)

    ellipse = fit_ellipse(outline, ON_OUTLINE_MM, TRIALS, may_be_dish, cover)
    if ellipse is None:
        return None
    return _Outline((-ellipse.beyond(view.centres_mm())).astype(np.float32), cover(ellipse))


def _cover(outline: Float64Array, ellipse: Ellipse) -> float:
    """Share of the directions from the ellipse's middle in which the outline lies on it."""
    near = outline[np.abs(ellipse.beyond(outline)) < ON_OUTLINE_MM] - ellipse.centre
    turn = np.arctan2(near[:, 1], near[:, 0])
    return len(np.unique(np.floor((turn + np.pi) / (2 * np.pi) * SECTORS))) / SECTORS


def _fit_rectangle(outline: Float64Array, view: TopView) -> _Outline | None:
    """The smallest rectangle around the outline."""
    box = cv2.minAreaRect(outline.astype(np.float32))
    corners = np.asarray(cv2.boxPoints(box), np.float32)
    if min(box[1]) <= 0 or max(box[1]) > 2 * MAX_ASPECT * min(box[1]):
        return None
    contour = corners.reshape(-1, 1, 2)
    near = [
        abs(cv2.pointPolygonTest(contour, (float(x), float(y)), measureDist=True))
        for x, y in outline
    ]
    cells = np.rint(view.cells_px(corners[None])[0]).astype(np.int32)
    return _Outline(inward_of(cells, view), float(np.mean(np.array(near) < ON_OUTLINE_MM)))


def _inward(dish: Dish, layout: Layout) -> Float32Array:
    return dish.inward_at(layout.view, layout.scene.xy_at(dish.rim_mm))


def _silhouette(dish: Dish, layout: Layout) -> MaskArray:
    """(h, w) the dish from its rim down to the table."""
    scene = layout.scene
    return (_inward(dish, layout) > 0) | (dish.inward_at(layout.view, scene.plane_xy_mm) > 0)


def _band(inward_mm: Float32Array, span_mm: tuple[float, float]) -> MaskArray:
    return (inward_mm > span_mm[0]) & (inward_mm < span_mm[1])


def _on_dish(scene: Scene, thing: MaskArray, inward_mm: Float32Array) -> MaskArray:
    """(h, w) what lies on a dish: unlike its rim, and not only along it; also what stands over it. thing: with it."""
    within = (thing | (inward_mm > 0)) & ~scene.is_ignored
    over = opened(thing & (inward_mm < -BESIDE_RIM_MM / 2), 5) & ~scene.is_ignored
    things = (
        _unlike(scene, _band(inward_mm, RIM_MM) & within, within, is_dish=True)
        & (inward_mm > -BESIDE_RIM_MM / 2)
        | over
    )
    deep = inward_mm > 2 * BESIDE_RIM_MM
    kept = [
        part
        for part in components(opened(things, 3))
        if np.count_nonzero(part & deep) > SHARE_INSIDE * np.count_nonzero(part)
    ]
    return np.any(kept, axis=0) if kept else np.zeros(thing.shape, np.bool_)
