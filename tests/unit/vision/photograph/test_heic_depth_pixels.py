"""The pixels of a HEIC's depth map: known values, turns, noise of few levels, and what cannot be decoded."""

import numpy as np
import pytest

from app.vision.photograph.heic_depth import decode_heic_depth
from tests.support.heic_files import heic_with_map

RGB = np.zeros((96, 128, 3), np.uint8)
TABLE_PER_M = np.repeat(np.linspace(1.6, 2.4, 96)[:, None], 128, axis=1)  # 1 / m
LEVELS = np.rint((TABLE_PER_M - 1.0) / 2.0 * 255).astype(np.uint8)
STEP_PER_M = 2.0 / 255


def decoded(levels=LEVELS, size=(128, 96), share=1.0, **changes):
    """share: of the file that is there."""
    ranges = {"level_range": (0.0, 255.0), "value_range": (1.0, 3.0)}
    description = {"orientation": 1, "is_inverse": True, "is_metric": True} | ranges
    data = heic_with_map(RGB, levels, None, quality=-1)
    return decode_heic_depth(data[: int(len(data) * share)], size=size, **description | changes)


def test_disparity_and_depth_give_depth_in_mm_turned_and_averaged():
    depth = decoded()
    np.testing.assert_allclose(1000 / depth.depth_mm, TABLE_PER_M, atol=1.5 * STEP_PER_M)  # rounded, and coded
    assert depth.is_aligned
    assert not depth.is_relative
    assert depth.sd_share > 0.5 * STEP_PER_M / np.sqrt(12) / 2.0  # of levels that are half a per cent apart
    np.testing.assert_array_equal(decoded(orientation=6).depth_mm, np.rot90(depth.depth_mm, -1))
    large = np.kron(LEVELS, np.ones((6, 6), np.uint8))
    assert decoded(large, size=(768, 576)).depth_mm.shape == (192, 256)  # averaged
    metres = 1 / TABLE_PER_M
    levels = np.rint((metres - 0.4) / 0.3 * 255).astype(np.uint8)
    of_metres = decoded(levels, value_range=(0.4, 0.7), is_inverse=False)
    np.testing.assert_allclose(of_metres.depth_mm, 1000 * metres, atol=2.0)


@pytest.mark.parametrize("value_range", [(1.0, 3.0), (-4.0, 7.0), (0.0, 1e-3)])
def test_relative_map_is_the_same_whatever_its_scale_and_offset(value_range):
    depth = decoded(value_range=value_range, is_metric=False)
    assert depth.is_relative
    np.testing.assert_allclose(depth.depth_mm, decoded(is_metric=False).depth_mm, rtol=1e-4)
    slope = np.polyfit(TABLE_PER_M.ravel(), 1 / depth.depth_mm.ravel(), 1)[0]
    assert slope > 0


@pytest.mark.parametrize(
    ("levels", "changes", "code"),
    [
        (LEVELS, {"size": (96, 128)}, "depth_unreadable"),
        (LEVELS, {"value_range": (-3.0, -1.0)}, "depth_empty"),
        (LEVELS, {"value_range": (-3.0, -1.0), "is_inverse": False}, "depth_unreadable"),
        (LEVELS, {"value_range": (1e3, 1e4)}, "depth_empty"),
        (np.full_like(LEVELS, 7), {"is_metric": False}, "depth_unreadable"),
        (LEVELS.astype(np.uint16) * 256, {}, "depth_unreadable"),
        (np.repeat(LEVELS[..., None], 3, axis=2), {}, "depth_unreadable"),
        (LEVELS[:16, :16], {"size": (16, 16)}, "depth_unreadable"),
        (LEVELS, {"share": 0.66}, "depth_unreadable"),
    ],
)
def test_map_of_no_use_is_refused(levels, changes, code):
    failure = decoded(levels, **changes)
    assert failure.code == code
