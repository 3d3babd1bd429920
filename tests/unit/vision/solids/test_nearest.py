import numpy as np
import pytest

from app.vision.solids.nearest import Nearest


@pytest.mark.parametrize("count", [1, 2, 9, 11, 700])
def test_nearest_is_that_of_all_distances(count):
    rng = np.random.default_rng(count)
    points, asked = (rng.uniform(0, 4000, (n, 2)) for n in (count, 150))
    distances = np.linalg.norm(asked[:, None] - points, axis=2)
    nearest, first = Nearest(points), points.copy()
    points += 1000.0  # which changes no answer
    distance, index = nearest.query(asked)
    assert np.allclose(distance, distances.min(axis=1), atol=1e-3)
    assert np.allclose(distances[np.arange(len(asked)), index], distances.min(axis=1), atol=1e-3)
    distance, index = nearest.query(first)
    assert np.array_equal(index, np.arange(count))
    assert (distance == 0).all()
