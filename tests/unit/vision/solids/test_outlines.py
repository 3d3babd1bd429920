import numpy as np
import pytest

from app.vision.model import Hint
from app.vision.solids.outlines import draw_hints, photograph_px, rings_of
from app.vision.views.reconstruction import plane_points
from app.vision.views.rectification import rectify_by_poses
from tests.unit.vision.stereo_scene import blank_views

FIRST, SECOND = blank_views()
PAIR = rectify_by_poses(FIRST, SECOND)


def places(is_swapped):
    return photograph_px(PAIR, plane_points(PAIR), SECOND if is_swapped else FIRST, is_swapped=is_swapped)


def middle_disc(radius=60):
    rows, columns = np.indices(PAIR.shape)
    mask = np.hypot(rows - PAIR.shape[0] / 2, columns - PAIR.shape[1] / 2) < radius
    return mask & PAIR.is_seen


@pytest.mark.parametrize("is_swapped", [False, True])
@pytest.mark.parametrize("hole_px", [0, 25])
def test_outline_drawn_as_a_polygon_gives_back_the_mask_with_its_hole_in_either_photograph(is_swapped, hole_px):
    mask, there = middle_disc() & ~middle_disc(hole_px), places(is_swapped)
    rings = rings_of(mask, there, is_swapped=is_swapped)
    assert len(rings) == (2 if hole_px else 1)
    assert np.ptp(rings[-1][:, 0]) <= np.ptp(rings[0][:, 0])  # the hole is the second one
    hint = Hint(polygon=tuple(tuple((float(x), float(y)) for x, y in ring) for ring in rings))
    back = draw_hints([hint], there, (1200, 900))[0]
    assert back.is_exact
    assert np.count_nonzero(back.mask & mask) / np.count_nonzero(back.mask | mask) > 0.95
    assert rings_of(np.zeros(PAIR.shape, bool), there, is_swapped=is_swapped) == ()


def test_point_and_box_are_drawn_where_they_are():
    there = places(False)
    row, column = PAIR.shape[0] // 2, PAIR.shape[1] // 2
    x, y = (float(v) for v in there[row, column])
    point, box = draw_hints([Hint(point=(x, y)), Hint(box=(x - 20, y - 10, 40, 20))], there, (1200, 900))
    assert point.mask[row, column]
    assert not point.is_box
    assert box.mask[row, column]
    assert box.is_box
    assert box.mask.sum() > point.mask.sum() > 0


def test_hint_outside_the_photograph_is_empty_and_one_without_a_place_is_left_out():
    (drawn,) = draw_hints([Hint(point=(-500.0, 5000.0)), Hint(food="apple")], places(False), (1200, 900))
    assert not drawn.mask.any()


def test_point_on_what_a_swapped_pair_did_not_measure_lies_at_the_nearest_that_it_did():
    """A glossy face that the views cannot compare: the grid knows only where its measured edges lie."""
    there = places(False).copy()
    row, column = PAIR.shape[0] // 2, PAIR.shape[1] // 2
    point = tuple(float(v) for v in there[row, column])
    there[row - 12 : row + 13, column - 12 : column + 13] = there[row, column + 13]
    (drawn,) = draw_hints([Hint(point=point)], there, (1200, 900))
    assert drawn.mask.any()
    assert np.linalg.norm(np.argwhere(drawn.mask).mean(axis=0) - [row, column]) < 25
    there[:] = np.nan
    (nowhere,) = draw_hints([Hint(point=point)], there, (1200, 900))
    assert not nowhere.mask.any()
