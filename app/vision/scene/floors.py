"""Tell boards from plates, and find the height of a board's top, by the plane that both views show within the rim.

A board is level up to its edge. A plate slopes down to a floor in the lower half of its rim's height. The likelihoods
of planes are weighed against both, so that neither a colour nor a measured height is needed.
"""

from dataclasses import replace

import numpy as np

from app.vision.geometry.masks import dilated, opened, window_around
from app.vision.geometry.topview import TableTrend, TopView
from app.vision.model import Float64Array, MaskArray
from app.vision.scene.dish import Dish
from app.vision.scene.scene import FINE_REACH_PX, Scene
from app.vision.tuning import FLOOR_TUNING


def with_floor(dish: Dish, scene: Scene, view: TopView, trend: TableTrend) -> Dish:
    """Return a board with its top as rim and floor, and any other dish unchanged."""
    if dish.is_deep or scene.sweep is None:
        return dish
    tuning = FLOOR_TUNING
    standing = np.nan_to_num(scene.height_mm) > dish.rim_mm + tuning.standing_mm
    standing = opened(standing & (scene.reach_px < FINE_REACH_PX), 3)
    inward = dish.inward_at(view, scene.xy_at(dish.rim_mm))
    low_mm, high_mm = tuning.ring_mm
    ring = (inward > low_mm) & (inward < high_mm) & ~dilated(standing, tuning.clear_px)
    # However high it lies, it is within the outline.
    ring &= (dish.inward_at(view, scene.plane_xy_mm) > low_mm) & ~scene.is_ignored
    table_mm = float(trend.height_mm(view.centres_mm()[dish.inward_mm > 0].mean(axis=0)))

    over_mm, sd_mm = tuning.board_over_rim_mm
    expected_mm = dish.rim_mm + over_mm
    heights_mm = np.arange(0.0, expected_mm + 3 * sd_mm, tuning.step_mm)
    a_board = _log_normal(heights_mm, expected_mm, sd_mm)
    a_plate = _log_normal(heights_mm, *(share * dish.rim_mm for share in tuning.plate_of_rim))

    def odds(seen: Float64Array) -> float:
        """Return the log odds of a board against a plate. seen: (n,) log likelihoods of the heights."""
        board = np.logaddexp.reduce(seen + a_board)
        plate = np.logaddexp.reduce(seen + a_plate)
        return float(board - plate)

    over_marker_mm = heights_mm + table_mm
    quarters = [scene.sweep.log_likelihoods(part, over_marker_mm) for part in _quarters(ring)]
    # What a single quarter tells may be food that no height shows.
    without_one = [np.sum(quarters, axis=0) - quarter for quarter in quarters]
    seen = min(without_one, key=odds)
    if odds(seen) < tuning.least_odds:
        return dish
    board = np.exp(seen + a_board - (seen + a_board).max())
    top_mm = float(np.average(heights_mm, weights=board))
    variance = float(np.average((heights_mm - top_mm) ** 2, weights=board))
    return replace(dish, rim_mm=top_mm, floor_mm=top_mm, floor_sd_mm=float(np.sqrt(variance)))


def _quarters(ring: MaskArray) -> list[MaskArray]:
    """Return the four quarters of a ring (h, w) about its middle."""
    rows, columns = np.ogrid[: ring.shape[0], : ring.shape[1]]
    middle_row, middle_column = ((each.start + each.stop) / 2 for each in window_around(ring, 0))
    is_lower, is_right = rows > middle_row, columns > middle_column
    return [ring & (is_lower == low) & (is_right == right) for low in (0, 1) for right in (0, 1)]


def _log_normal(values: Float64Array, mean: float, sd: float) -> Float64Array:
    return np.asarray(-0.5 * ((values - mean) / sd) ** 2 - np.log(sd), np.float64)
