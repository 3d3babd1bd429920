"""Depth maps by their headers, and their locations taken out."""

import io
import struct

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from app.photos.depth import TIFF, inspect_depth
from app.photos.location import remove_location
from tests.support.depth_maps import confidence_png, depth_png, depth_tiff, table_mm
from tests.support.photo_files import XMP


@pytest.fixture
def path(tmp_path):
    return tmp_path / "map"


def tagged_tiff():
    """A depth map with a GPS directory and an XMP packet, as no phone should write it."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[700] = XMP
    tags.tagtype[700] = 1
    tags[0x8825] = {1: "N", 2: (40.0, 25.0, 41.37), 3: "W", 4: (86.0, 54.0, 49.13)}
    buffer = io.BytesIO()
    Image.fromarray(table_mm().astype(np.float32)).save(buffer, "TIFF", tiffinfo=tags)
    return buffer.getvalue()


def test_size_and_format_are_those_of_the_header_and_a_confidence_map_or_an_empty_file_is_no_map(path):
    for content, media_type in ((depth_png(), "image/png"), (depth_tiff(), TIFF)):
        path.write_bytes(content)
        facts = inspect_depth(path)
        assert (facts.media_type, facts.width, facts.height) == (media_type, 64, 48)
    path.write_bytes(confidence_png())
    assert inspect_depth(path, is_confidence=True).pixels_to_decode == 64 * 48
    assert inspect_depth(path).code == "depth_unreadable"
    path.write_bytes(b"")
    assert inspect_depth(path).code == "depth_unreadable"


def test_location_of_a_tiff_goes_and_its_depth_stays(path):
    before = tagged_tiff()
    path.write_bytes(before)
    assert remove_location(path, inspect_depth(path))
    after = path.read_bytes()
    assert len(after) == len(before)
    with Image.open(io.BytesIO(after)) as image:
        assert 0x8825 not in image.tag_v2
        np.testing.assert_array_equal(np.asarray(image), table_mm().astype(np.float32))
    assert b"GPSLatitude" in before
    assert b"GPSLatitude" not in after
    path.write_bytes(depth_tiff())
    assert not remove_location(path, inspect_depth(path))


def with_directory(change):
    """The TIFF with its first directory's entries changed. change: list of 12 bytes -> list of 12 bytes."""
    content = depth_tiff()
    start = struct.unpack_from("<I", content, 4)[0]
    count = struct.unpack_from("<H", content, start)[0]
    entries = [content[start + 2 + 12 * n : start + 14 + 12 * n] for n in range(count)]
    changed = change(entries)
    directory = struct.pack("<H", len(changed)) + b"".join(changed) + b"\0\0\0\0"
    return content[:4] + struct.pack("<I", len(content)) + content[8:] + directory


def entry(tag, value):
    return struct.pack("<HHIHH", tag, 3, 1, value, 0)


def test_tag_that_stands_twice_or_a_turned_tiff_is_no_map(path):
    path.write_bytes(with_directory(list))
    assert inspect_depth(path).width == 64
    for added in (entry(0x100, 16000), entry(0x112, 3), entry(0x112, 6)):
        path.write_bytes(with_directory(lambda entries, added=added: [added, *entries]))
        assert inspect_depth(path).code == "depth_unreadable"
