import numpy as np

from app.vision.solids.fields import parallax_field


def test_what_is_not_known_has_no_part_in_a_place_between_the_pixels():
    parallax = np.full((40, 40), np.nan, np.float32)
    parallax[:, :20] = 30.0
    sd = np.full((40, 40), 0.2, np.float32)
    field = parallax_field(parallax, sd, np.isfinite(parallax), area_px=100.0, origin=(7, 5))
    columns = np.linspace(10.0, 24.0, 57)
    value, spread, known = field.at(np.column_stack([columns + 7, np.full(57, 20.0 + 5)]))
    assert np.allclose(value[known > 0], 30.0, atol=1e-4)
    assert np.allclose(spread[known > 0], 0.2, atol=1e-5)
    assert np.all(np.diff(known) <= 1e-9)
    assert (known[0], known[-1]) == (1.0, 0.0)
