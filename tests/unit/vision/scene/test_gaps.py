import numpy as np
import pytest

from app.vision.scene.gaps import find_gaps, hole_by_colour

SHAPE = (80, 100)
MM = 1.0


def disc(radius):
    rows, columns = np.indices(SHAPE)
    return np.hypot(rows - 40, columns - 50) < radius


def ring(hole_mm=2.0, hole_radius=10, food_mm=20.0):
    """Raised parts and heights of a ring; the ring speaks for food by two nats, all else against it."""
    hole = disc(hole_radius)
    is_raised = disc(30) & ~hole
    height = np.where(is_raised, food_mm, 0.0).astype(np.float32)
    height[hole] = hole_mm
    colour = np.where(is_raised, 2.0, -2.0).astype(np.float32)
    return is_raised, height, colour, hole


def test_low_hole_of_the_supports_colour_is_a_gap_by_its_middle_at_any_scale():
    is_raised, height, colour, hole = ring()
    before = [array.copy() for array in (is_raised, height, colour)]
    gaps = find_gaps(is_raised, height, colour, MM)
    assert all(np.array_equal(a, b) for a, b in zip(before, (is_raised, height, colour), strict=True))
    assert gaps[40, 50]
    assert not (gaps & ~hole).any()
    assert 0.1 * np.count_nonzero(hole) < np.count_nonzero(gaps) < 0.6 * np.count_nonzero(hole)
    assert np.array_equal(find_gaps(is_raised, 2 * height, colour, 2 * MM), gaps)


def test_dent_foods_colour_unmeasured_hole_speck_and_open_bay_are_no_gaps():
    is_raised, height, colour, hole = ring()
    of_food, unmeasured, bay = colour.copy(), height.copy(), (slice(38, 43), slice(50, None))
    of_food[hole], unmeasured[hole] = 2.0, np.nan
    open_raised, open_height = is_raised.copy(), height.copy()
    open_raised[bay], open_height[bay] = False, 2.0
    seen = {
        "dent higher than half its surroundings": ring(hole_mm=12.0)[:3],
        "food's colour": (is_raised, height, of_food),
        "unmeasured": (is_raised, unmeasured, colour),
        "speck": ring(hole_radius=3)[:3],
        "open bay": (open_raised, open_height, colour),
    }
    assert [name for name, (raised, mm, nats) in seen.items() if find_gaps(raised, mm, nats, MM).any()] == []


def painted(hole_bgr, hole_radius=10, middle=(40, 50)):
    """A grained brown disc on a white support, with a spot of a colour."""
    rows, columns = np.indices(SHAPE)
    spot = np.hypot(rows - middle[0], columns - middle[1]) < hole_radius
    picture = np.full((*SHAPE, 3), (210, 215, 220), np.float32)
    picture[disc(30)] = (60, 90, 140)
    picture[spot] = hole_bgr
    grain = np.random.default_rng(0).normal(0, 3, picture.shape)
    return np.clip(picture + grain, 0, 255).astype(np.uint8), spot


NOTHING = np.zeros(SHAPE, np.bool_)


@pytest.mark.parametrize("hole_bgr", [(210, 215, 220), (158, 162, 166)], ids=["lit", "in shade"])
def test_single_views_ring_has_the_hole_through_which_its_support_shows(hole_bgr):
    picture, spot = painted(hole_bgr)
    hole = hole_by_colour(disc(30), NOTHING, picture)
    assert np.count_nonzero(hole & spot) > 0.75 * np.count_nonzero(hole | spot)


def test_spot_of_another_colour_beside_the_middle_or_in_a_food_a_few_pixels_wide_is_no_hole():
    support_bgr = (210, 215, 220)
    spots = [(30, painted((40, 160, 60))), (30, painted(support_bgr, middle=(40, 66))), (5, painted(support_bgr, 2))]
    assert not any(hole_by_colour(disc(radius), NOTHING, picture).any() for radius, (picture, _) in spots)
