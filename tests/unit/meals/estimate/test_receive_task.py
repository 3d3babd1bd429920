"""A photograph in the child: cut, read again, and written anew where the cut harmed it."""

import hashlib
import io

import numpy as np
import pillow_heif
import pytest
from PIL import ExifTags, Image

from app.meals.estimate import receive_task as module
from app.meals.estimate.receive_task import receive_task
from app.photos.inspect import inspect_photo
from app.photos.location import read_location
from app.vision.photograph.photo import read_photo
from tests.support.photo_files import FOCAL_35MM, TAKEN_AT, exif_block
from tests.support.photographs import photograph

EXIF = b"Exif\0\0" + exif_block(orientation=6)
KINDS = {
    "image/jpeg": {"quality": 95, "subsampling": 0},
    "image/png": {"mode": "L"},
    "image/webp": {"lossless": True},
    "image/heic": {"quality": 95},
}


def encoded(media_type):
    kind = media_type.removeprefix("image/").replace("heic", "heif").upper()
    pillow_heif.register_heif_opener()
    return photograph(kind=kind, exif=EXIF, **KINDS[media_type])


def received(path, **changes):
    request = {"file": str(path), "slot": "left", "max_pixels": 1_000_000, "reads_location": True}
    request |= {"cuts_location": True, "depth_camera": None, "is_costly": False}
    return receive_task(request | changes, lambda _: None)


@pytest.mark.parametrize("media_type", KINDS)
def test_location_is_cut_and_all_else_stays(tmp_path, media_type):
    path = tmp_path / "photo"
    path.write_bytes(encoded(media_type))
    before = read_photo(path.read_bytes(), max_pixels=1_000_000)
    answer = received(path)
    facts = answer["facts"]
    after = read_photo(path.read_bytes(), max_pixels=1_000_000)
    assert (answer["failure"], facts["media_type"], facts["is_reencoded"]) == (None, media_type, False)
    assert (facts["width_px"], facts["height_px"], len(answer["location"])) == (480, 640, 2)
    assert facts["stored_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert read_location(path, inspect_photo(path)) is None
    np.testing.assert_array_equal(before.pixels_bgr, after.pixels_bgr)


@pytest.mark.parametrize("media_type", KINDS)
@pytest.mark.parametrize("harm", ["pixels", "orientation"])
def test_photograph_that_the_cut_harmed_is_written_anew(tmp_path, monkeypatch, media_type, harm):
    path = tmp_path / "photo"
    path.write_bytes(encoded(media_type))
    before = read_photo(path.read_bytes(), max_pixels=1_000_000)

    def remove(file, _):
        data = file.read_bytes()
        file.write_bytes(photograph(1) if harm == "orientation" else data[: len(data) // 2])
        return True

    monkeypatch.setattr(module, "remove_location", remove)
    answer = received(path)
    facts = answer["facts"]
    data = path.read_bytes()
    anew = {"image/jpeg": "image/jpeg", "image/heic": "image/jpeg"}.get(media_type, "image/png")
    assert (answer["failure"], facts["media_type"], facts["is_reencoded"]) == (None, anew, True)
    assert (facts["width_px"], facts["height_px"], facts["bytes"]) == (480, 640, len(data))
    inspected = inspect_photo(path)
    assert (inspected.media_type, inspected.orientation, read_location(path, inspected)) == (anew, 6, None)
    after = read_photo(data, max_pixels=1_000_000)
    difference = np.abs(before.pixels_bgr.astype(int) - after.pixels_bgr).max()
    assert difference == 0 if anew == "image/png" else difference < 12
    assert after.focal_35mm == pytest.approx(FOCAL_35MM, rel=1e-4)
    assert Image.open(io.BytesIO(data)).getexif().get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] == TAKEN_AT


def test_heic_whose_exif_lies_in_its_picture_keeps_its_picture(tmp_path):
    """Cutting what calls itself EXIF would cut the picture."""
    path = tmp_path / "photo"
    data = bytearray(encoded("image/heic"))
    base_at = data.index(b"\0\2\0\0", data.index(b"iloc") + 26) + 4  # of the second item in `iloc`
    data[base_at : base_at + 4] = (5000).to_bytes(4)
    before = read_photo(bytes(data), max_pixels=1_000_000)
    path.write_bytes(data)
    assert received(path)["facts"]["is_reencoded"] is True
    after = read_photo(path.read_bytes(), max_pixels=1_000_000)
    assert np.abs(before.pixels_bgr.astype(int) - after.pixels_bgr).max() < 12
