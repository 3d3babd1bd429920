from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.topview import view_from_above
from app.vision.scene.dish import find_dishes, solid_cells


def view_of(height_of, noise_mm=0.4, seed=0):
    """A square metre of a quarter seen from above, three points to a cell's side."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-250, 250, 1.0), np.arange(-250, 250, 1.0)))
    z = height_of(x, y) + rng.normal(0, noise_mm, x.size)
    points = np.column_stack([x, y, z])[np.isfinite(z)].astype(np.float32)
    return view_from_above(points, points[:, 2])


def found_in(view, noise_mm=0.4, with_floor=lambda dish: dish):
    """The best dish, or None."""
    rng = np.random.default_rng(0)
    return next(iter(find_dishes(view, solid_cells(view, 1.0), noise_mm, rng, with_floor)), None)


def as_board(dish):
    return replace(dish, floor_mm=dish.rim_mm)


def plate(x, y, radius=110.0, rim=14.0, floor=3.0):
    r = np.hypot(x - 20, y + 30)
    return np.where(r < radius - 10, floor, np.where(r < radius, rim, 0.0))


def test_plates_rim_is_found_with_its_circle_and_distances_inward():
    view = view_of(plate)
    dish = found_in(view)
    assert dish.centre_mm == pytest.approx([20, -30], abs=3)
    assert dish.radius_mm == pytest.approx(105, abs=6)  # the rim is 10 mm wide
    assert dish.rim_mm == pytest.approx(14, abs=1)
    assert dish.floor_mm == 0
    assert not dish.is_deep
    inward = dish.inward_at(view, np.array([[[20.0, -30.0], [20.0, 100.0], [np.nan, 0.0], [5000.0, 0.0]]]))
    assert inward[0, :2] == pytest.approx([dish.radius_mm, dish.radius_mm - 130], abs=4)
    assert inward[0, 2] == inward[0, 3] == -100  # where nothing is known
    unmeasured = found_in(view_of(lambda x, y: np.where(np.hypot(x - 20, y + 30) < 100, np.nan, plate(x, y))))
    assert unmeasured.radius_mm == pytest.approx(105, abs=6)
    by_wrong_poses = found_in(view_of(lambda x, y: plate(x, y) + 0.03 * x * (np.hypot(x, y) < 160)))
    assert by_wrong_poses.radius_mm is not None


@pytest.mark.parametrize(
    ("content", "seen_turn"), [((60, 38.0), np.pi), ((55, 27.0), 0.65 * np.pi)], ids=["whole", "in part"]
)
def test_filled_bowl_is_deep_and_its_rim_not_its_content_is_found(content, seen_turn):
    def heights(x, y):
        r, gap = np.hypot(x, y), np.nan
        rim = np.where(np.abs(np.arctan2(y, x)) <= seen_turn, 48.0, gap)
        return np.select([r < content[0], r < 68, r < 73, r < 80], [content[1], gap, rim, gap], 0.0)

    dish = found_in(view_of(heights))
    assert dish.is_deep
    assert dish.radius_mm == pytest.approx(70, abs=4)
    assert dish.rim_mm == pytest.approx(48, abs=1)


def test_board_with_something_on_it_is_a_slab_or_round():
    square, disc = (lambda x, y: (np.abs(x) < 90) & (np.abs(y) < 120)), (lambda x, y: np.hypot(x, y) < 110)
    for is_board, top_mm in ((square, 15.0), (disc, 18.0)):
        view = view_of(
            lambda x, y, b=is_board, z=top_mm: np.where(np.hypot(x, y) < 30, 55.0, np.where(b(x, y), z, 0.0))
        )
        dish = found_in(view, with_floor=as_board)
        assert dish.rim_mm == pytest.approx(top_mm, abs=0.5)
        assert (dish.radius_mm is None) == (is_board is square)


def three_foods(x, y):
    """A circle follows a banana's back, crosses a heap at half its width and runs along an egg's flank."""
    r, turn = np.hypot(x, y), np.arctan2(y, x)
    across = ((r - 68) / 18) ** 2
    is_banana = (turn > -0.4) & (turn < 1.8) & (across < 1)
    banana = np.where(is_banana, 18 * (1 + np.sqrt(np.maximum(1 - across, 0))), 0.0)
    heap = 21 - ((x + 80) ** 2 + y**2) / 120
    egg = 45 - ((x + 5) ** 2 + (y + 85) ** 2) / 25
    height = np.maximum.reduce([banana, heap, egg])
    return np.where(height > 0, height, np.nan)


def edge(x, y, across, down):
    """1 along the border of a rectangle with these half-axes, 0 in its middle."""
    return np.maximum(np.abs(x) / across, np.abs(y) / down)


NO_DISHES = {  # heights, noise in mm, and that which is told
    "slice with a bulge": (
        lambda x, y: np.where(edge(x, y, 57, 52) < 1, 22 - 8 * edge(x, y, 57, 52) ** 4, 0),
        0.8,
        0.8,
    ),
    "lying pack into whose top a circle fits": (lambda x, y: np.where(edge(x, y, 150, 95) < 1, 60.0, 0.0), 1.0, 1.0),
    "round flat food": (lambda x, y: np.where(np.hypot(x, y) < 55, 15.0, 0.0), 0.4, 0.4),
    "flat block on which nothing stands": (lambda x, y: np.where(edge(x, y, 72, 72) < 1, 30.0, 0.0), 0.4, 0.4),
    "mound": (lambda x, y: 40 * np.sqrt(np.clip(1 - (x**2 + y**2) / 70**2, 0, 1)), 0.4, 0.4),
    "noisy table": (lambda x, y: 0 * x, 4.0, 2.0),
    "circle through three foods": (three_foods, 1.0, 1.0),
}


@pytest.mark.parametrize(("heights", "noise_mm", "told_mm"), NO_DISHES.values(), ids=NO_DISHES)
def test_what_stands_on_the_bare_table_is_no_dish(heights, noise_mm, told_mm):
    assert found_in(view_of(heights, noise_mm), told_mm) is None
