"""The table laid out: the picture on a reduced grid with heights over the table alone, seen from above, and its dishes.

The rectified pair with its points -> Scene and Layout, in which foods are looked for.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.vision.geometry.pictures import grey_of
from app.vision.geometry.topview import (
    TableTrend,
    TopView,
    fit_table_trend,
    usable_points,
    view_from_above,
)
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.colour_bins import fine_texture
from app.vision.scene.dish import Dish, find_dishes, solid_cells
from app.vision.scene.floors import with_floor
from app.vision.scene.plane_sweep import PlaneSweep
from app.vision.scene.scene import Scene
from app.vision.views.disparity import COLOUR_REACH_PX, DisparityMap
from app.vision.views.rectification import RectifiedPair

REDUCTION = 2  # of the rectified grid, on which foods are found; outlines are carried back by a smooth field
LOWEST_MM = -30.0  # below the table: strays
CLEAR_OF_DISH_MM = 10.0  # beyond its outline, where the table is seen
TABLE_WINDOW_PX = 15
# grey levels, standard deviation in a window, from which on the views can be compared
TABLE_TEXTURE = 4.0
MOST_OF_IT = 0.5  # of what a mask shows, that lies over a dish


@dataclass(frozen=True, slots=True)
class Layout:
    """The scene with heights over a table that no dish has a part in, seen from above, and its dishes.

    things: (h, w) dishes and foods on the table by their colours; empty until by_colour.py looks for them
    """

    scene: Scene
    trend: TableTrend
    view: TopView
    dishes: list[Dish]
    things: MaskArray


def reduced_scene(
    pair: RectifiedPair, disparity: DisparityMap, points_table: Float32Array, ignored: MaskArray
) -> tuple[Scene, TableTrend]:
    """The scene with heights over the table as all points show it, and that table. ignored: (H, W) sheet, unseen."""
    every = slice(None, None, REDUCTION)
    points = np.ascontiguousarray(points_table[every, every])
    is_ignored = np.ascontiguousarray(ignored[every, every])
    height, width = is_ignored.shape
    trend = fit_table_trend(points[usable_points(points, is_ignored)])
    return (
        Scene(
            image_bgr=np.asarray(
                cv2.resize(pair.first_bgr, (width, height), interpolation=cv2.INTER_AREA), np.uint8
            ),
            height_mm=(points[..., 2] - trend.height_mm(points[..., :2])).astype(np.float32),
            points_table=points,
            reach_px=np.ascontiguousarray(disparity.reach_px[every, every]) / np.float32(REDUCTION),
            is_ignored=is_ignored,
            plane_xy_mm=_plane_xy(pair),
            camera_mm=pair.first_centre_mm,
            pixel_mm=REDUCTION * pair.pixel_mm,
            texture=np.ascontiguousarray(fine_texture(pair.first_bgr)[every, every]),
            table_correlation=_table_correlation(pair),
            sweep=PlaneSweep.of_pair(pair, REDUCTION),
        ),
        trend,
    )


def without_heights(scene: Scene) -> Scene:
    """The scene by its picture alone: a depth map's outlines are coarser than the photograph's."""
    nothing = np.full_like(scene.height_mm, np.nan)
    reach = np.full_like(scene.reach_px, COLOUR_REACH_PX / REDUCTION)
    points = np.full_like(scene.points_table, np.nan)
    return replace(scene, height_mm=nothing, points_table=points, reach_px=reach)


def _table_correlation(pair: RectifiedPair) -> Float32Array:
    """(h, w) normalised cross correlation of both views at parallax zero, the marker's plane.

    NaN where it is plain, and everywhere in a single view.
    """
    if pair.second_bgr is None:
        height, width = pair.shape
        return np.full((-(-height // REDUCTION), -(-width // REDUCTION)), np.nan, np.float32)
    first, second = (grey_of(image).astype(np.float32) for image in pair.both_bgr)
    mean, mean_second = _window_mean(first), _window_mean(second)
    variance = _window_mean(first * first) - mean * mean
    variance_second = _window_mean(second * second) - mean_second * mean_second
    covariance = _window_mean(first * second) - mean * mean_second
    correlation = covariance / np.sqrt(np.maximum(variance, 1.0) * np.maximum(variance_second, 1.0))
    return np.where(variance > TABLE_TEXTURE**2, correlation, np.float32(np.nan)).astype(np.float32)


def _window_mean(image: Float32Array) -> Float32Array:
    """(h, w) on the reduced grid, over windows of the whole one."""
    side = (TABLE_WINDOW_PX, TABLE_WINDOW_PX)
    return np.ascontiguousarray(
        cv2.boxFilter(image, -1, side)[::REDUCTION, ::REDUCTION], np.float32
    )


def _plane_xy(pair: RectifiedPair) -> Float32Array:
    """(h, w, 2) where the rays of the reduced grid meet the marker's plane, mm; far away above the horizon."""
    height, width = pair.shape
    u = ((np.arange(0, width, REDUCTION) - pair.centre_px[0]) / pair.focal_px).astype(np.float32)
    v = ((np.arange(0, height, REDUCTION) - pair.centre_px[1]) / pair.focal_px).astype(np.float32)
    x, y, z = (
        row[0] * u[None, :] + row[1] * v[:, None] + row[2]
        for row in pair.rotation.T.astype(np.float32)
    )
    reach = np.float32(pair.first_centre_mm[2]) / np.maximum(-z, np.float32(1e-3))
    centre = pair.first_centre_mm.astype(np.float32)
    return np.stack([centre[0] + reach * x, centre[1] + reach * y], axis=-1)


def lay_out(scene: Scene, trend: TableTrend) -> Layout | None:
    """None where nothing was measured."""
    usable = usable_points(scene.points_table, scene.is_ignored)
    raised = usable & (np.nan_to_num(scene.height_mm) > LOWEST_MM)
    view = view_from_above(scene.points_table[raised], scene.height_mm[raised])
    if view is None:
        return None
    dishes = find_dishes(
        view,
        solid_cells(view, 1.0 / scene.pixel_mm**2),
        trend.noise_mm,
        np.random.default_rng(0),
        lambda dish: with_floor(dish, scene, view, trend),
    )
    nothing = np.zeros(usable.shape, np.bool_)
    if not dishes:
        return Layout(scene, trend, view, dishes, nothing)
    inward = np.max([dish.inward_at(view, scene.points_table[..., :2]) for dish in dishes], axis=0)
    better = fit_table_trend(scene.points_table[usable & (inward < -CLEAR_OF_DISH_MM)])
    height = scene.points_table[..., 2] - better.height_mm(scene.points_table[..., :2])
    lifted = [_lifted(dish, view, trend, better) for dish in dishes]
    return Layout(
        replace(scene, height_mm=height.astype(np.float32)), better, view, lifted, nothing
    )


def _lifted(dish: Dish, view: TopView, trend: TableTrend, better: TableTrend) -> Dish:
    """The dish with its heights over the better table."""
    middle = view.centres_mm()[dish.inward_mm > 0].mean(axis=0)
    step = float(trend.height_mm(middle) - better.height_mm(middle))
    floor_mm = max(dish.floor_mm + step, 0.0) if dish.floor_mm > 0 else 0.0
    return replace(dish, rim_mm=max(dish.rim_mm + step, 1.0), floor_mm=floor_mm)


def dish_under(mask: MaskArray, layout: Layout) -> Dish | None:
    """The dish over which most of what a mask (h, w) shows lies; None for the table."""
    points = layout.scene.points_table[..., :2]
    measured = mask & np.isfinite(layout.scene.points_table[..., 2])
    shares = [
        float(np.mean(dish.inward_at(layout.view, points)[measured] > 0))
        if measured.any()
        else float(np.mean(dish.inward_at(layout.view, layout.scene.xy_at(dish.rim_mm))[mask] > 0))
        for dish in layout.dishes
    ]
    if not shares or max(shares) < MOST_OF_IT:
        return None
    return layout.dishes[int(np.argmax(shares))]
