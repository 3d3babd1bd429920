import numpy as np
import pytest

from app.vision.figures import PLY_VERTEX, write_ply


def test_ply_holds_points_and_colours_in_rgb_order():
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 5.5, 0.0]])
    data = write_ply(points, np.array([[10, 20, 30], [40, 50, 60]], np.uint8))
    header, _, body = data.partition(b"end_header\n")
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b"element vertex 2\n" in header
    vertices = np.frombuffer(body, PLY_VERTEX)
    assert np.allclose(vertices["xyz"], points)
    assert vertices["rgb"].tolist() == [[30, 20, 10], [60, 50, 40]]
    with pytest.raises(ValueError, match="colours"):
        write_ply(points, np.zeros((1, 3), np.uint8))
