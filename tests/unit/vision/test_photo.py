"""Reading photographs: every format and orientation gives the same upright pixels; hostile bytes give a Failure."""

import io
import struct
import zlib

import numpy as np
import pillow_heif
import pytest
from PIL import Image, TiffImagePlugin

from app.core.errors import Failure
from app.vision.model import Photo
from app.vision.photo import MIN_SHORT_SIDE_PX, read_photo
from tests.support.photographs import photograph, with_hole

MAX_PIXELS = 50_000_000
WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="module")
def picture() -> Image.Image:
    """Smooth, and different at each corner and in each channel."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    red, green, blue = x * 255 / (WIDTH - 1), y * 255 / (HEIGHT - 1), (x + y) * 60 / (WIDTH + HEIGHT)
    return Image.fromarray(np.stack([red, green, blue], -1).astype(np.uint8))


def encoded(image: Image.Image, kind: str, **options) -> bytes:
    stream = io.BytesIO()
    if kind == "HEIF":
        pillow_heif.from_pillow(image).save(stream, quality=95, **options)
    else:
        image.save(stream, kind, **options)
    return stream.getvalue()


def read(data: bytes, max_pixels: int = MAX_PIXELS) -> Photo:
    photo = read_photo(data, max_pixels=max_pixels)
    assert isinstance(photo, Photo), photo
    return photo


def failure_code(data: bytes, max_pixels: int = MAX_PIXELS) -> str:
    failure = read_photo(data, max_pixels=max_pixels)
    assert isinstance(failure, Failure)
    assert failure.message.endswith(".")
    return failure.code


def assert_alike(photo: Photo, picture: Image.Image, tolerance: float = 4.0) -> None:
    expected = np.asarray(picture.convert("RGB"))[..., ::-1]
    assert photo.pixels_bgr.dtype == np.uint8
    assert photo.pixels_bgr.flags.c_contiguous
    assert photo.pixels_bgr.shape == expected.shape
    assert np.abs(photo.pixels_bgr.astype(float) - expected).mean() < tolerance


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "HEIF"])
def test_every_format_gives_the_same_pixels(picture, kind):
    assert_alike(read(encoded(picture, kind)), picture)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_each_exif_orientation_is_applied_once(picture, orientation, kind):
    undo = {
        2: Image.Transpose.FLIP_LEFT_RIGHT,
        3: Image.Transpose.ROTATE_180,
        4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE,
        6: Image.Transpose.ROTATE_90,  # Pillow turns counter-clockwise: stored so, orientation 6 turns it back
        7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }
    stored = picture.transpose(undo[orientation]) if orientation in undo else picture
    exif = Image.Exif()
    exif[274] = orientation
    assert_alike(read(encoded(stored, kind, exif=exif)), picture)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_heic_orientation_is_not_applied_twice(picture, orientation):
    undo = {3: Image.Transpose.ROTATE_180, 6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270}
    stored = picture.transpose(undo[orientation]) if orientation in undo else picture
    exif = Image.Exif()
    exif[274] = orientation  # pillow-heif writes it as HEIC's own rotation
    assert_alike(read(encoded(stored, "HEIF", exif=exif.tobytes())), picture)


def test_sixteen_bit_png_is_scaled_to_eight(picture):
    grey = np.asarray(picture.convert("L"))
    data = encoded(Image.fromarray(grey.astype(np.uint16) * 257), "PNG")
    assert_alike(read(data), Image.fromarray(grey), tolerance=0.01)


def test_sixteen_bit_colour_png_is_scaled_to_eight(picture):
    deep = (np.asarray(picture).astype(">u2") * 257).reshape(HEIGHT, -1)
    rows = b"".join(b"\0" + row.tobytes() for row in deep)
    assert_alike(read(png(WIDTH, HEIGHT, rows, depth=16)), picture, tolerance=1.0)


@pytest.mark.parametrize("mode", ["L", "P", "1"])
def test_grey_palette_and_bilevel_png_are_read(picture, mode):
    image = picture.convert(mode)
    assert_alike(read(encoded(image, "PNG")), image)


def test_grey_jpeg_is_read(picture):
    assert_alike(read(encoded(picture.convert("L"), "JPEG")), picture.convert("L"))


def test_cmyk_jpeg_is_read(picture):
    assert_alike(read(encoded(picture.convert("CMYK"), "JPEG", quality=95)), picture.convert("CMYK"))


def test_transparency_is_laid_on_white(picture):
    layer = picture.convert("RGBA")
    layer.putalpha(0)
    assert (read(encoded(layer, "PNG")).pixels_bgr == 255).all()


def test_exif_tells_focal_length_and_phone(picture):
    exif = Image.Exif()
    exif[272] = " Pixel 6a\0 "
    exif.get_ifd(0x8769)[41989] = 27
    photo = read(encoded(picture, "JPEG", exif=exif))
    assert (photo.focal_35mm, photo.model) == (27.0, "Pixel 6a")


def test_heic_exif_is_read(picture):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = 26
    assert read(encoded(picture, "HEIF", exif=exif.tobytes())).focal_35mm == 26.0


def test_focal_length_follows_from_the_sensor_where_the_tag_lacks(picture):
    # A 36 x 24 mm sensor is its own equivalent: 640 px over 36 mm are 17.78 px a mm; 3:2 needs 427 rows.
    exif = Image.Exif()
    sub = exif.get_ifd(0x8769)
    sub[37386], sub[41486], sub[41488] = 50.0, TiffImagePlugin.IFDRational(6400, 36), 3  # a cm
    sub[40962], sub[40963] = 640, 427
    assert read(encoded(picture, "JPEG", exif=exif)).focal_35mm == pytest.approx(50.0, rel=1e-3)


@pytest.mark.parametrize(
    ("tag", "value"),
    [
        (41989, 0),
        (41989, 65535),
        (36867, "0000:00:00 00:00:00"),
        (36867, "yesterday"),
        (36881, "+99:99"),
        (37386, TiffImagePlugin.IFDRational(4, 0)),
        (41486, TiffImagePlugin.IFDRational(0, 0)),
        (41488, 77),
    ],
)
def test_nonsense_in_exif_is_passed_over(picture, tag, value):
    exif = Image.Exif()
    sub = exif.get_ifd(0x8769)
    sub[37386], sub[41486] = 4.0, 5000.0
    sub[tag] = value
    photo = read(encoded(picture, "JPEG", exif=exif))
    assert photo.focal_35mm is None or np.isfinite(photo.focal_35mm)


def test_random_exif_bytes_never_raise(picture):
    exif = Image.Exif()
    exif[271], exif[274] = "Maker", 6
    exif.get_ifd(0x8769)[41989] = 27
    good = exif.tobytes()
    rng = np.random.default_rng(1)
    for _ in range(200):
        bad = bytearray(good)
        for at in rng.integers(6, len(bad), 6):
            bad[at] = rng.integers(256)
        assert isinstance(read_photo(encoded(picture, "JPEG", exif=bytes(bad)), max_pixels=MAX_PIXELS), Photo)


@pytest.mark.parametrize("data", [b"", b"GIF89a" + b"\0" * 100, b"hello", b"\0\0\0\x18ftypisom" + b"\0" * 50])
def test_other_bytes_are_not_an_image(data):
    assert failure_code(data) == "not_an_image"


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "HEIF"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.97])
def test_cut_file_is_truncated(picture, kind, share):
    data = encoded(picture, kind)
    assert failure_code(data[: max(16, int(len(data) * share))]) == "image_truncated"


def test_thumbnails_end_mark_does_not_make_a_cut_file_whole(picture):
    thumbnail = encoded(picture.resize((80, 60)), "JPEG")
    comment = b"\xff\xfe" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    data = encoded(picture, "JPEG")
    assert isinstance(read(data[:2] + comment + data[2:]), Photo)
    assert failure_code(data[:2] + comment + data[2 : len(data) // 2]) == "image_truncated"


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("at", [0.3, 0.6, 0.9])
def test_jpeg_that_lost_bytes_in_its_middle_is_unreadable(progressive, at):
    """It was decoded with grey where the bytes were lost, and measured."""
    whole = photograph(3, size=(WIDTH, HEIGHT), progressive=progressive)
    assert isinstance(read(whole), Photo)
    assert failure_code(with_hole(whole, at, 2000)) == "image_unreadable"


def test_few_bytes_too_many_before_a_jpegs_end_cost_nothing():
    whole = photograph(3, size=(WIDTH, HEIGHT))
    padded = read(whole[:-2] + bytes(16) + whole[-2:])
    assert (padded.pixels_bgr == read(whole).pixels_bgr).all()


def test_jpeg_in_cmyk_is_read():
    assert read(photograph(3, size=(WIDTH, HEIGHT), mode="CMYK")).pixels_bgr.shape == (HEIGHT, WIDTH, 3)


def test_damaged_png_is_unreadable(picture):
    data = bytearray(encoded(picture, "PNG"))
    data[len(data) // 2 : len(data) // 2 + 64] = bytes(64)
    assert failure_code(bytes(data)) == "image_unreadable"


def test_bomb_is_refused_by_its_header():
    # 60000 x 60000 pixels announced, one row of zeros behind: decoding it would ask for 10 GB.
    failure = read_photo(png(60_000, 60_000, bytes(60_000)), max_pixels=MAX_PIXELS)
    assert isinstance(failure, Failure)
    assert failure.code == "image_too_many_pixels"
    assert str(MAX_PIXELS) in failure.message


def test_pixel_limit_is_inclusive(picture):
    data = encoded(picture, "JPEG")
    assert read_photo(data, max_pixels=WIDTH * HEIGHT)
    assert failure_code(data, WIDTH * HEIGHT - 1) == "image_too_many_pixels"


def test_preview_is_too_small(picture):
    assert failure_code(encoded(picture.crop((0, 0, WIDTH, MIN_SHORT_SIDE_PX - 1)), "JPEG")) == "image_too_small"


def png(width: int, height: int, rows: bytes, depth: int = 8) -> bytes:
    """An RGB PNG with this header, whatever its rows are."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, depth, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
