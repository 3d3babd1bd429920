import numpy as np

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


def test_low_hole_of_the_supports_colour_is_a_gap_by_its_middle():
    is_raised, height, colour, hole = ring()
    gaps = find_gaps(is_raised, height, colour, MM)
    assert gaps[40, 50]
    assert not (gaps & ~hole).any()
    assert 0.1 * np.count_nonzero(hole) < np.count_nonzero(gaps) < 0.6 * np.count_nonzero(hole)


def test_dent_that_is_higher_than_half_its_surroundings_is_no_gap():
    is_raised, height, colour, _ = ring(hole_mm=12.0)
    assert not find_gaps(is_raised, height, colour, MM).any()


def test_low_part_of_the_foods_colour_is_no_gap():
    is_raised, height, colour, hole = ring()
    colour[hole] = 2.0
    assert not find_gaps(is_raised, height, colour, MM).any()


def test_unmeasured_hole_is_no_gap():
    is_raised, height, colour, hole = ring()
    height[hole] = np.nan
    assert not find_gaps(is_raised, height, colour, MM).any()


def test_speck_is_no_gap():
    is_raised, height, colour, _ = ring(hole_radius=3)
    assert not find_gaps(is_raised, height, colour, MM).any()


def test_bay_that_is_open_to_the_outside_is_no_gap():
    is_raised, height, colour, _ = ring()
    is_raised[38:43, 50:] = False
    height[38:43, 50:] = 2.0
    assert not find_gaps(is_raised, height, colour, MM).any()


def test_gap_of_a_scene_twice_as_large_is_the_same():
    is_raised, height, colour, _ = ring()
    same = find_gaps(is_raised, 2 * height, colour, 2 * MM)
    assert np.array_equal(find_gaps(is_raised, height, colour, MM), same)


def test_inputs_are_not_changed():
    is_raised, height, colour, _ = ring()
    before = [array.copy() for array in (is_raised, height, colour)]
    find_gaps(is_raised, height, colour, MM)
    assert all(np.array_equal(a, b) for a, b in zip(before, (is_raised, height, colour), strict=True))


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


def test_single_views_ring_has_the_hole_through_which_its_support_shows():
    picture, spot = painted((210, 215, 220))
    hole = hole_by_colour(disc(30), NOTHING, picture)
    shared, either = np.count_nonzero(hole & spot), np.count_nonzero(hole | spot)
    assert shared > 0.75 * either


def test_hole_in_shade_is_one_as_well():
    picture, spot = painted((158, 162, 166))  # the support by half of its light
    hole = hole_by_colour(disc(30), NOTHING, picture)
    assert np.count_nonzero(hole & spot) > 0.75 * np.count_nonzero(spot)


def test_spot_of_another_colour_is_no_hole():
    picture, _ = painted((40, 160, 60))
    assert not hole_by_colour(disc(30), NOTHING, picture).any()


def test_spot_of_the_supports_colour_beside_the_middle_is_no_hole():
    picture, _ = painted((210, 215, 220), middle=(40, 66))
    assert not hole_by_colour(disc(30), NOTHING, picture).any()


def test_food_that_is_a_few_pixels_wide_has_no_hole():
    picture, _ = painted((210, 215, 220), hole_radius=2)
    assert not hole_by_colour(disc(5), NOTHING, picture).any()
