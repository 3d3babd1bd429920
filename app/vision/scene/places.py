"""Where food may lie: on each dish and on the table beside them, each with its own part of the picture.

Dishes seen from above, heights -> one Place per dish and one per group of things on the table: where geometry alone is
sure of food, where food may be, where the dish shows its colour, and what belongs to another place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from app.vision.geometry.masks import components, dilated, distance_px, opened, without_specks
from app.vision.geometry.topview import TopView
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.dish import Dish
from app.vision.scene.food_checks import MIN_AREA_MM2
from app.vision.scene.half_measured import unlike_support
from app.vision.scene.scene import Scene

OVER_RIM_MM = 7.0  # higher than the rim: food, wherever it is
OVER_FLOOR_MM = 8.0  # and within the dish or on the bare table, away from the rim
RIM_BAND_MM = (3.0, 14.0)  # inward from the outline, where the dish shows its colour
RIM_SLOPE_MM = 35.0  # inward from the outline, within which a plate may rise to its rim
WALL_MM = 6.0  # inward from a bowl's outline: its wall
BOWL_CORE_SHARE = 0.4  # of a bowl's radius, inward from its outline: its content, not its wall
OVERHANG_MM = 5.0  # by which food may lie beyond the dish's outline
# beyond a dish's outline, from which on what stands is not its rim widened by a window
BESIDE_DISH_MM = 9.0
REACH_MM = 40.0  # around what is surely food, beyond which nothing is food: on the bare table, and in a dish
REACH_IN_DISH_MM = 12.0
GROUP_MM = 12.0  # things on the table that are nearer to each other share a place
MIN_SURE_MM2 = {"dish": 150.0, "table": 60.0}  # a plate's floor is measured worst, beside its food
OPENING_PX = {"dish": 5, "table": 3}
SILHOUETTE_STEPS = 4  # heights between table and rim at which a dish's outline is drawn
UNMEASURED_MM = -99.0
ON_TABLE, AT_RIM = -1, -2
# beyond a dish's silhouette, within which a window may have seen its rim or side
WINDOW_REACH_PX = 8


@dataclass(frozen=True, slots=True)
class Place:
    """A support and its part of the scene's grid, (h, w) masks.

    dish: None for the table. is_sure: stands higher than the support can. may_be_food: outside of it nothing is.
    shows_dish: the dish's own colour. is_elsewhere: belongs to another place. rim_mm: what food rises above;
    floor_mm: of a board, else 0.
    """

    dish: Dish | None
    is_sure: MaskArray
    may_be_food: MaskArray
    shows_dish: MaskArray
    is_elsewhere: MaskArray

    @property
    def rim_mm(self) -> float:
        """Height over the table that food on this support rises above, wherever it lies; 0 for the table."""
        return self.dish.rim_mm if self.dish is not None else 0.0

    @property
    def is_measured(self) -> bool:
        """Whether heights show the support itself: the table or a board, not a plate's plain floor."""
        return self.dish is None or self.dish.floor_mm > 0

    @property
    def floor_mm(self) -> float:
        """Height of the support over the table, mm; 0 where it is not known."""
        return self.dish.floor_mm if self.dish is not None else 0.0


@dataclass(frozen=True, slots=True)
class _Territory:
    """A dish's part of the picture, (h, w).

    seen_inward: distance inward from its outline, mm, if a pixel shows the rim's plane; inward: of the point that it
    shows. silhouette: rim and side; margin: that and what windows mix with it.
    """

    dish: Dish
    seen_inward: Float32Array
    inward: Float32Array
    silhouette: MaskArray
    margin: MaskArray


def find_places(
    scene: Scene, dishes: Sequence[Dish], view: TopView, points: Sequence[MaskArray] = ()
) -> list[Place]:
    """The places that hold food, by their heights or by points: (h, w) small parts that are food for certain."""
    tall = np.nan_to_num(
        np.where(scene.is_ignored, np.float32(np.nan), scene.height_mm), nan=UNMEASURED_MM
    )
    territories = [_territory(scene, dish, view) for dish in dishes]
    owner = _owners(territories, tall.shape)
    blobs = _half_measured(scene, territories, owner)
    owner = _whole_blobs(blobs, owner, np.isfinite(scene.height_mm))
    certain = blobs
    for point in points:
        certain = certain | (point & ~scene.is_ignored)
    sure = [
        _solid(_stands_on(territory, tall) & (owner == number), scene, "dish")
        | (certain & (owner == number))
        for number, territory in enumerate(territories)
    ]
    is_clear = owner == ON_TABLE
    for territory in territories:
        is_clear &= ~(territory.margin & (tall < territory.dish.rim_mm + OVER_RIM_MM))
    on_table = _solid((tall > OVER_FLOOR_MM) & is_clear, scene, "table") | (
        certain & (owner == ON_TABLE)
    )
    groups = groups_of(on_table, scene)
    places = [
        _on_dish(scene, number, territories, sure, on_table)
        for number, is_sure in enumerate(sure)
        if is_sure.any()
    ]
    return places + [
        _on_table(scene, group, territories, [*sure, on_table & ~group]) for group in groups
    ]


def left_over(place: Place, taken: MaskArray, scene: Scene) -> Place | None:
    """Return the place with only what stands there and is not taken (h, w), if it may be a food.

    Beside foods of other colours it may have looked like the support.
    """
    left = place.is_sure & ~dilated(taken, 2 * WINDOW_REACH_PX + 1)
    left = without_specks(opened(left, OPENING_PX["dish"]), MIN_AREA_MM2 / scene.pixel_mm**2)
    if not left.any():
        return None
    near = place.may_be_food & (distance_px(left) * scene.pixel_mm < REACH_MM) & ~taken
    return replace(place, is_sure=left, may_be_food=near)


def _territory(scene: Scene, dish: Dish, view: TopView) -> _Territory:
    seen_inward = dish.inward_at(view, scene.xy_at(dish.rim_mm))
    inward = dish.inward_at(view, scene.points_table[..., :2])
    inward = np.where(np.isfinite(scene.points_table[..., 2]), inward, seen_inward)
    silhouette = seen_inward > 0
    for height in np.linspace(0.0, dish.rim_mm, SILHOUETTE_STEPS)[:-1]:
        silhouette |= dish.inward_at(view, scene.xy_at(float(height))) > 0
    margin = distance_px(silhouette) < WINDOW_REACH_PX
    return _Territory(dish, seen_inward, inward, silhouette, margin)


def _owners(territories: Sequence[_Territory], shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) number of the dish that each pixel's point lies on or over; else ON_TABLE, or AT_RIM just beside one."""
    if not territories:
        return np.full(shape, ON_TABLE)
    inward = np.stack([territory.inward for territory in territories])
    nearest, distance = inward.argmax(axis=0), inward.max(axis=0)
    return np.where(
        distance > -OVERHANG_MM, nearest, np.where(distance < -BESIDE_DISH_MM, ON_TABLE, AT_RIM)
    )


def _half_measured(scene: Scene, territories: Sequence[_Territory], owner: np.ndarray) -> MaskArray:
    """(h, w) blobs that stand out although little of them was measured, see half_measured.py."""
    over_support = scene.height_mm.copy()
    for number, territory in enumerate(territories):
        over_support[owner == number] -= np.float32(territory.dish.floor_mm)
    is_measured = np.isfinite(scene.height_mm)  # what is not may be food in front of a rim
    shows_dish = [_own_colour(territory, scene) & is_measured for territory in territories]
    return unlike_support(scene, over_support, shows_dish)


def _whole_blobs(blobs: MaskArray, owner: np.ndarray, is_measured: MaskArray) -> np.ndarray:
    """The owners, each blob wholly to whom most of its measured points belong: rays beside them may pass a rim."""
    whole = owner.copy()
    for blob in components(blobs):
        owners = owner[blob & is_measured]
        owners = owners[owners != AT_RIM]
        if len(owners):
            values, counts = np.unique(owners, return_counts=True)
            whole[blob] = values[counts.argmax()]
    return whole


def _own_colour(territory: _Territory, scene: Scene) -> MaskArray:
    """(h, w) the band along its rim where a dish shows its colour."""
    dish = territory.dish
    outermost = WALL_MM if dish.is_deep else RIM_BAND_MM[1]
    band = (territory.seen_inward > RIM_BAND_MM[0]) & (territory.seen_inward < outermost)
    return band & ~(np.nan_to_num(scene.height_mm, nan=UNMEASURED_MM) > dish.rim_mm + OVERHANG_MM)


def _stands_on(territory: _Territory, tall: Float32Array) -> MaskArray:
    dish = territory.dish
    slope = BOWL_CORE_SHARE * dish.radius_mm if dish.is_deep and dish.radius_mm else RIM_SLOPE_MM
    sure = tall > dish.rim_mm + OVER_RIM_MM
    return sure | ((tall > dish.floor_mm + OVER_FLOOR_MM) & (territory.inward > slope))


def _solid(mask: MaskArray, scene: Scene, where: Literal["dish", "table"]) -> MaskArray:
    return without_specks(opened(mask, OPENING_PX[where]), MIN_SURE_MM2[where] / scene.pixel_mm**2)


def _on_dish(
    scene: Scene,
    number: int,
    territories: Sequence[_Territory],
    sure: Sequence[MaskArray],
    on_table: MaskArray,
) -> Place:
    own, is_sure = territories[number], sure[number]
    band = _own_colour(own, scene)
    elsewhere = on_table.copy()
    for other, territory in enumerate(territories):
        if other != number:
            elsewhere |= sure[other] | (territory.silhouette & (own.seen_inward <= 0))
    may_be_food = (own.seen_inward > 0) | (distance_px(is_sure) * scene.pixel_mm < REACH_IN_DISH_MM)
    return Place(own.dish, is_sure, may_be_food, band, elsewhere & ~is_sure)


def _on_table(
    scene: Scene,
    is_sure: MaskArray,
    territories: Sequence[_Territory],
    sure_elsewhere: Sequence[MaskArray],
) -> Place:
    elsewhere = np.any(
        [*(territory.silhouette for territory in territories), *sure_elsewhere], axis=0
    )
    may_be_food = distance_px(is_sure) * scene.pixel_mm < REACH_MM
    return Place(
        None, is_sure, may_be_food, np.zeros(is_sure.shape, np.bool_), elsewhere & ~is_sure
    )


def groups_of(on_table: MaskArray, scene: Scene) -> list[MaskArray]:
    """What stands on the table, divided where wide gaps part it: colours are learned near each group alone."""
    if not on_table.any():
        return []
    return [
        on_table & group
        for group in components(distance_px(on_table) * scene.pixel_mm < GROUP_MM / 2)
    ]
