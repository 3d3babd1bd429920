"""Where boards may lie: found among texture, small, tilted, blurred or in shadow; texture alone costs no detector."""

import cv2
import numpy as np
import pytest

from app.vision.board.marker import contrast_image
from app.vision.board.search import find_grids
from app.vision.marker_spec import parse_marker
from tests.unit.vision.synthetic import PHONE, look_at, noise_texture, paint_over, project, render_board

DETECTORS = ("findChessboardCornersSBWithMeta", "findChessboardCornersSB", "findChessboardCorners")
PLAIN, COLOUR = "plain:9x7:11", "colour:4x5:12"


def first_size(photo, spec):
    """Rows and columns of inner corners of the first grid, fewer first."""
    contrast = contrast_image(photo.pixels_bgr, is_coloured=spec.is_coloured)
    grid = next(find_grids(contrast, (spec.columns - 1, spec.rows - 1)))
    return sorted(grid.shape[:2])


@pytest.mark.parametrize("blur_px", [6.0, 12.0])
def test_texture_without_a_board_runs_no_detector(monkeypatch, blur_px):
    """Such a texture has saddle points everywhere; detectors took seconds to find nothing among them."""
    for name in DETECTORS:
        monkeypatch.setattr(cv2, name, lambda *_, **__: pytest.fail("a detector ran"))
    noise = np.random.default_rng(4).normal(0.0, 1.0, (900, 1200))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    texture = np.clip(128 + 50 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    assert list(find_grids(texture, (8, 6))) == []


@pytest.mark.parametrize(
    ("marker", "pose", "render"),
    [
        (PLAIN, look_at(60, -70, 450.0), {}),
        (PLAIN, look_at(80, -60, 1500.0), {}),  # squares of 7 px
        (PLAIN, look_at(25, -60, 400.0), {}),
        (PLAIN, look_at(60, -70, 450.0), {"blur_px": 3.0}),
        (PLAIN, look_at(60, -70, 450.0), {"shadow": 0.3}),
        (COLOUR, look_at(50, -50, 450.0), {"shadow": 0.5}),
    ],
    ids=["plain", "small", "tilted", "blurred", "shadow", "coloured"],
)
def test_board_among_texture_is_found(marker, pose, render):
    spec = parse_marker(marker)
    photo = render_board(spec, PHONE, pose, table=noise_texture(2), **render)
    assert first_size(photo, spec) == sorted((spec.rows - 1, spec.columns - 1))


def test_part_of_a_board_is_found():
    spec, pose = parse_marker(PLAIN), look_at(60, -70, 450.0)
    photo = render_board(spec, PHONE, pose, table=noise_texture(2))
    half = project(PHONE, pose, np.array([[5, 90, 0], [90, 90, 0], [90, -90, 0], [5, -90, 0]], float))
    rows, columns = first_size(paint_over(photo, half), spec)
    assert rows >= 3
    assert columns < 8
