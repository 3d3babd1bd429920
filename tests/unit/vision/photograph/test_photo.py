"""Reading photographs: every format and orientation gives the same upright pixels; hostile bytes give a Failure."""

import io
import struct
import zlib

import cv2
import numpy as np
import pillow_heif
import pytest
import simplejpeg
from PIL import Image, TiffImagePlugin

from app.vision.model import Photo
from app.vision.photograph.photo import MIN_SHORT_SIDE_PX, read_photo, read_reduced_photo
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
    assert failure.message.endswith(".")
    return failure.code


def assert_alike(photo: Photo, picture: Image.Image, tolerance: float = 4.0) -> None:
    expected = np.asarray(picture.convert("RGB"))[..., ::-1]
    assert photo.pixels_bgr.dtype == np.uint8
    assert photo.pixels_bgr.flags.c_contiguous
    assert photo.pixels_bgr.shape == expected.shape
    assert np.abs(photo.pixels_bgr.astype(float) - expected).mean() < tolerance


UNDO = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,  # Pillow turns counter-clockwise: stored so, orientation 6 turns it back
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


@pytest.mark.parametrize(
    ("kind", "orientation"),
    [*(("JPEG", number) for number in range(1, 9)), ("PNG", 1), ("PNG", 6), ("WEBP", 1), ("WEBP", 6)]
    + [("HEIF", number) for number in (1, 3, 6, 8)],  # pillow-heif writes it as HEIC's own rotation
)
def test_every_format_gives_the_same_pixels_and_its_orientation_is_applied_once(picture, orientation, kind):
    stored = picture.transpose(UNDO[orientation]) if orientation in UNDO else picture
    exif = Image.Exif()
    exif[274] = orientation
    exif.get_ifd(0x8769)[41989] = 26
    photo = read(encoded(stored, kind, exif=exif.tobytes() if kind == "HEIF" else exif))
    assert_alike(photo, picture)
    assert photo.focal_35mm == 26.0


def test_sixteen_bit_png_is_scaled_to_eight(picture):
    grey = np.asarray(picture.convert("L"))
    data = encoded(Image.fromarray(grey.astype(np.uint16) * 257), "PNG")
    assert_alike(read(data), Image.fromarray(grey), tolerance=0.01)
    deep = (np.asarray(picture).astype(">u2") * 257).reshape(HEIGHT, -1)
    rows = b"".join(b"\0" + row.tobytes() for row in deep)
    assert_alike(read(png(WIDTH, HEIGHT, rows, depth=16)), picture, tolerance=1.0)


@pytest.mark.parametrize(("mode", "kind"), [("L", "PNG"), ("P", "PNG"), ("1", "PNG"), ("L", "JPEG"), ("CMYK", "JPEG")])
def test_grey_palette_bilevel_and_cmyk_pictures_are_read(picture, mode, kind):
    image = picture.convert(mode)
    assert_alike(read(encoded(image, kind, **({"quality": 95} if mode == "CMYK" else {}))), image)


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


def test_focal_length_follows_from_the_sensor_where_the_tag_lacks(picture):
    # A 36 x 24 mm sensor is its own equivalent: 640 px over 36 mm are 17.78 px a mm; 3:2 needs 427 rows.
    exif = Image.Exif()
    sub = exif.get_ifd(0x8769)
    sub[37386], sub[41486], sub[41488] = 50.0, TiffImagePlugin.IFDRational(6400, 36), 3  # a cm
    sub[40962], sub[40963] = 640, 427
    assert read(encoded(picture, "JPEG", exif=exif)).focal_35mm == pytest.approx(50.0, rel=1e-3)


NONSENSE = {
    41989: [0, 65535],
    36867: ["0000:00:00 00:00:00", "yesterday"],
    36881: ["+99:99"],
    37386: [TiffImagePlugin.IFDRational(4, 0)],
    41486: [TiffImagePlugin.IFDRational(0, 0)],
    41488: [77],
}


def test_nonsense_in_exif_is_passed_over(picture):
    for tag, values in NONSENSE.items():
        for value in values:
            exif = Image.Exif()
            exif.get_ifd(0x8769).update({37386: 4.0, 41486: 5000.0, tag: value})
            photo = read(encoded(picture, "JPEG", exif=exif))
            assert photo.focal_35mm is None or np.isfinite(photo.focal_35mm)


@pytest.mark.parametrize("data", [b"", b"GIF89a" + b"\0" * 100, b"hello", b"\0\0\0\x18ftypisom" + b"\0" * 50])
def test_other_bytes_are_not_an_image(data):
    assert failure_code(data) == "not_an_image"


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "HEIF"])
@pytest.mark.parametrize("share", [0.02, 0.97])
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
@pytest.mark.parametrize("at", [0.3, 0.9])
def test_file_that_lost_bytes_in_its_middle_is_unreadable(picture, progressive, at):
    """It was decoded with grey where the bytes were lost, and measured."""
    whole = photograph(3, size=(WIDTH, HEIGHT), progressive=progressive)
    few_too_many = read(whole[:-2] + bytes(16) + whole[-2:])  # before the end, they cost nothing
    assert (few_too_many.pixels_bgr == read(whole).pixels_bgr).all()
    assert failure_code(with_hole(whole, at, 2000)) == "image_unreadable"
    lost = bytearray(encoded(picture, "PNG"))
    lost[len(lost) // 2 : len(lost) // 2 + 64] = bytes(64)
    assert failure_code(bytes(lost)) == "image_unreadable"


@pytest.mark.parametrize("interlaced", [False, True])
def test_png_that_lacks_its_last_rows_is_unreadable(interlaced):
    """Pillow leaves them black. Passes of Adam7: 1/64, 1/64, 1/32, 1/16, 1/8, 1/4 and 1/2 of all pixels."""
    side = 480
    passes = [(8, 8), (8, 8), (4, 8), (4, 4), (2, 4), (2, 2), (1, 2)] if interlaced else [(1, 1)]
    rows = b"".join((b"\0" + bytes([99] * (side // x * 3))) * (side // y) for x, y in passes)
    assert (read(png(side, side, rows, interlaced=interlaced)).pixels_bgr == 99).all()
    assert failure_code(png(side, side, rows[: -3 * side - 1], interlaced=interlaced)) == "image_unreadable"


def test_bomb_is_refused_by_its_header():
    # 60000 x 60000 pixels announced, one row of zeros behind: decoding it would ask for 10 GB.
    failure = read_photo(png(60_000, 60_000, bytes(60_000)), max_pixels=MAX_PIXELS)
    assert failure.code == "image_too_many_pixels"
    assert str(MAX_PIXELS) in failure.message


def test_pixel_limit_is_inclusive_and_a_preview_is_too_small(picture):
    data = encoded(picture, "JPEG")
    assert read(data, WIDTH * HEIGHT)
    assert failure_code(data, WIDTH * HEIGHT - 1) == "image_too_many_pixels"
    assert read(encoded(picture.crop((0, 0, WIDTH, MIN_SHORT_SIDE_PX)), "JPEG"))
    assert failure_code(encoded(picture.crop((0, 0, WIDTH, MIN_SHORT_SIDE_PX - 1)), "JPEG")) == "image_too_small"


def png(width: int, height: int, rows: bytes, depth: int = 8, *, interlaced: bool = False) -> bytes:
    """An RGB PNG with this header, whatever its rows are."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, depth, 2, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("options", [{}, {"subsampling": 0}, {"progressive": True}], ids=str)
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_whole_jpeg_is_decoded_once_to_the_pixels_of_opencv(monkeypatch, picture, mode, options):
    data = encoded(picture.convert(mode).resize((641, 487)), "JPEG", **options)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
    calls, decode = [], simplejpeg.decode_jpeg
    monkeypatch.setattr(
        simplejpeg, "decode_jpeg", lambda *args, **kwargs: calls.append(args) or decode(*args, **kwargs)
    )
    read_half = read_reduced_photo(data, max_pixels=MAX_PIXELS, least_long_side_px=320)
    assert len(calls) == 1
    assert read_half.factor == 2
    assert np.array_equal(read_half.photo.pixels_bgr, expected)
    assert np.array_equal(read(data).pixels_bgr, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
