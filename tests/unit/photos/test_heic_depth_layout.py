"""The depth map that a HEIC's boxes and XMP describe, and which maps are none or of no use."""

import numpy as np
import pytest
from PIL import Image

from app.core.errors import Failure
from app.photos.heic_depth import HeicDepth, read_heic_depth
from app.photos.heif import read_heif_layout
from tests.support.heic_files import MATTE, heic_with_map, packet

RGB = np.zeros((96, 128, 3), np.uint8)
LEVELS = np.repeat(np.arange(48, dtype=np.uint8)[:, None], 64, axis=1)


def layout_of(xmp, levels=LEVELS, **options):
    data = heic_with_map(RGB, levels, xmp, **options)
    layout = read_heif_layout(data, has_auxiliaries=True)
    assert layout.damage is None  # the photograph is sound whatever stands beside it
    return read_heic_depth(data, layout)


def test_disparity_of_two_cameras_is_relative_measured_depth_metric_and_a_matte_no_depth():
    depth = HeicDepth(64, 48, 1, (0.0, 255.0), (0.360596, 1.800781), is_inverse=True, is_metric=False)
    assert layout_of(packet(0.360596, 1.800781)) == depth
    depth = layout_of(packet(0.25, 1.5, accuracy="absolute", native="hdep"))
    assert (depth.is_inverse, depth.is_metric, depth.value_range) == (False, True, (0.25, 1.5))
    assert layout_of(packet(0, 1), urn=MATTE) is None
    assert layout_of(packet(0, 1, native="L008")) is None  # a matte may call itself depth


@pytest.mark.parametrize(
    ("orientation", "is_turned", "expected"),
    [(3, True, (1, 64, 48)), (6, True, (1, 48, 64)), (8, True, (1, 48, 64)), (6, False, (6, 64, 48))],
)
def test_map_takes_the_photographs_turn_unless_it_is_turned_itself(orientation, is_turned, expected):
    exif = Image.Exif()
    exif[0x112] = orientation
    depth = layout_of(packet(0, 1), exif=exif.tobytes(), is_map_turned=is_turned)
    assert (depth.orientation, depth.width, depth.height) == expected


@pytest.mark.parametrize(
    "xmp",
    [packet(low, high) for low, high in [("nan", 1), (0, "inf"), (1, 1), (2, 1), ("", 1), (0, "1e300"), (0, "9" * 80)]]
    + [None, b"<x:xmpmeta/>", b"\xff" * 1000, packet(0, 1)[:300]],
)
def test_map_without_its_keys_or_of_no_range_is_refused(xmp):
    failure = layout_of(xmp)
    assert isinstance(failure, Failure)
    assert failure.code == "depth_unreadable"


def test_map_of_another_shape_than_the_photograph_or_a_huge_one_is_refused_before_it_is_decoded():
    assert layout_of(packet(0, 1), levels=LEVELS[:40]).code == "depth_unreadable"
    data = heic_with_map(RGB, LEVELS, packet(0, 1))
    before, kind, size = data.rpartition(b"ispe\0\0\0\0")
    huge = before + kind + (64_000).to_bytes(4) + (48_000).to_bytes(4) + size[8:]
    assert read_heic_depth(huge, read_heif_layout(huge, has_auxiliaries=True)).code == "depth_unreadable"


def test_broken_box_of_the_map_leaves_the_photograph_sound_and_a_damaged_file_has_no_map():
    before, _, after = heic_with_map(RGB, LEVELS, packet(0, 1)).rpartition(b"pixi")
    layout = read_heif_layout(before + b"clap" + after, has_auxiliaries=True)  # too short for an aperture
    assert (layout.width, layout.damage, layout.auxiliaries) == (128, None, ())
    data = heic_with_map(RGB, LEVELS, packet(0, 1))
    cut = data[: data.index(b"ispe") + 6]
    assert read_heic_depth(cut, read_heif_layout(cut, has_auxiliaries=True)) is None
