import numpy as np
import pytest

from app.vision.geometry.nearest import Nearest


@pytest.mark.parametrize("count", [1, 2, 9, 11, 700])
def test_nearest_is_that_of_all_distances(count):
    rng = np.random.default_rng(count)
    points, asked = (rng.uniform(0, 4000, (n, 2)) for n in (count, 150))
    distances = np.linalg.norm(asked[:, None] - points, axis=2)
    distance, index = Nearest(points).query(asked)
    assert np.allclose(distance, distances.min(axis=1), atol=1e-3)
    assert np.allclose(distances[np.arange(len(asked)), index], distances.min(axis=1), atol=1e-3)


def test_points_themselves_are_at_distance_zero():
    points = np.random.default_rng(0).uniform(0, 4000, (300, 2))
    distance, index = Nearest(points).query(points)
    assert np.array_equal(index, np.arange(300))
    assert (distance == 0).all()


def test_answer_does_not_depend_on_what_becomes_of_the_points():
    points = np.array([[10.0, 10.0], [20.0, 20.0]])
    nearest = Nearest(points)
    points += 1000.0
    assert nearest.query(np.array([[19.0, 19.0]]))[1][0] == 1
