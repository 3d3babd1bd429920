"""Inspecting files: facts of whole photographs, a stable code for everything else, and no surprise on hostile bytes."""

import io
import struct

import pillow_heif
import pytest
from PIL import ExifTags, Image

from app.core.errors import Failure
from app.photos import heif
from app.photos import png as png_module
from app.photos.inspect import PhotoFacts, inspect_photo
from tests.support.photo_files import (
    HEIGHT,
    WIDTH,
    animated_webp,
    box,
    exif_block,
    exif_segment,
    grid_heic,
    heic,
    jpeg,
    picture,
    png,
    png_chunk,
    png_itxt,
    riff,
    segment,
    video,
    webp,
    webp_chunk,
    xmp_segment,
)


@pytest.fixture
def inspect(tmp_path):
    path = tmp_path / "photo"

    def run(data: bytes) -> PhotoFacts | Failure:
        path.write_bytes(data)
        return inspect_photo(path)

    return run


def code(result: PhotoFacts | Failure) -> str:
    assert isinstance(result, Failure)
    assert result.message.endswith(".")
    assert result.advice
    return result.code


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"restart_marker_blocks": 2}])
def test_jpeg_of_every_coding_is_whole(inspect, options):
    scans = 10 if options.get("progressive") else 1
    assert inspect(jpeg(**options)) == PhotoFacts("image/jpeg", WIDTH, HEIGHT, 1, WIDTH * HEIGHT, scans)


@pytest.mark.parametrize("mode", ["RGB", "L", "I;16", "P", "RGBA"])
def test_png_of_every_mode_is_whole(inspect, mode):
    stream = io.BytesIO()
    (Image.new(mode, (WIDTH, HEIGHT)) if mode == "I;16" else picture().convert(mode)).save(stream, "PNG")
    assert inspect(stream.getvalue()) == PhotoFacts("image/png", WIDTH, HEIGHT, 1, WIDTH * HEIGHT)


@pytest.mark.parametrize("size", [(97, 65), (130, 70)])
def test_heic_has_the_size_that_libheif_decodes(inspect, size):
    data = heic(image=picture().resize(size))
    facts = inspect(data)
    assert (facts.width, facts.height) == pillow_heif.open_heif(data).size == size
    assert facts.pixels_to_decode >= size[0] * size[1]


@pytest.mark.parametrize("order", ["<", ">"])
def test_orientation_is_read_in_both_byte_orders_and_is_1_out_of_range(inspect, order):
    for orientation in (*range(1, 9), 0, 9, 65535):
        block = exif_block(order, orientation=orientation)
        expected = orientation if orientation in range(1, 9) else 1
        assert inspect(jpeg(exif_segment(block))).orientation == expected
        assert inspect(png(png_chunk(b"eXIf", block))).orientation == expected


@pytest.mark.parametrize("form", [b'tiff:Orientation="6"', b"tiff:Orientation>6</tiff:Orientation"])
def test_orientation_is_taken_from_xmp_where_exif_tells_none(inspect, form):
    packet = b"<x:xmpmeta " + form + b"/>"
    unturned = Image.Exif()
    unturned[ExifTags.Base.Make] = "Acme"
    assert inspect(jpeg(xmp_segment(packet))).orientation == 6
    assert inspect(jpeg(xmp_segment(packet), exif=unturned)).orientation == 6
    assert inspect(jpeg(xmp_segment(packet), exif_segment(exif_block(orientation=3)))).orientation == 3
    assert inspect(png(png_itxt(packet))).orientation == 6
    for data in (jpeg(xmp_segment(packet)), png(png_itxt(packet))):
        assert Image.open(io.BytesIO(data)).getexif()[ExifTags.Base.Orientation] == 6


@pytest.mark.parametrize(("quarters", "orientation"), [(0, 1), (1, 8), (2, 3), (3, 6)])
def test_heic_grid_has_the_size_of_the_grid_and_the_turn_of_irot(inspect, quarters, orientation):
    facts = inspect(grid_heic(8, 6, 512, quarters))
    assert facts == PhotoFacts("image/heic", 8 * 512 - 10, 6 * 512 - 6, orientation, 8 * 512 * 6 * 512)


def test_tiles_of_a_heic_count_as_often_as_they_are_named_and_pictures_made_of_one_another_are_refused(inspect):
    """A small grid of a thousand references to one large tile is a thousand tiles to a decoder."""
    facts = inspect(grid_heic(1, 1, 4096, names=1000))
    assert (facts.width, facts.height) == (4086, 4090)
    assert facts.pixels_to_decode == 1000 * 4096**2
    failure = inspect(grid_heic(1, 1, 512, part=1))
    assert (failure.code, "one another" in failure.message) == ("image_unreadable", True)


def test_properties_of_a_heic_are_walked_a_few_times_whoever_names_the_item(inspect, monkeypatch):
    """A hundred overlays that name the same hundred tiles each: 172 kB of that held the server for 14 s."""
    walks = []
    properties = heif._properties
    monkeypatch.setattr(heif, "_properties", lambda file, item: walks.append(item) or properties(file, item))
    parts = heif._read_references

    def read_references(file, iref):
        parts(file, iref)
        tiles = file.parts[1]
        file.parts |= {1: tiles[:50]} | dict.fromkeys(tiles[:50], tiles[50:])

    monkeypatch.setattr(heif, "_read_references", read_references)
    assert inspect(grid_heic(10, 10, 512)).pixels_to_decode == 50 * 50 * 512**2
    assert len(walks) <= 3 * 101


def progressive_of_size(width, height, *, scans):
    """The structure of such a JPEG; its frame header's size is not that of what was encoded."""
    stream = io.BytesIO()
    picture().save(stream, "JPEG", progressive=True)
    whole = bytearray(stream.getvalue())
    frame = whole.index(b"\xff\xc2")
    whole[frame + 5 : frame + 9] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    last_scan = whole[whole.rindex(b"\xff\xda") : -2]
    return bytes(whole[:-2] + last_scan * (scans - whole.count(b"\xff\xda")) + b"\xff\xd9")


@pytest.mark.parametrize(
    ("side", "scans", "words"),
    [
        (640, 100, None),
        (640, 101, "more than 100 scans"),  # a last scan of 91 bytes, repeated 2,000 times, held a decoder for 20 s
        (7680, 10, None),
        (7680, 98, "more scans than"),  # of 59 megapixels: held a decoder for seconds at each request
    ],
)
def test_jpeg_of_too_many_scans_for_its_size_is_refused(inspect, side, scans, words):
    result = inspect(progressive_of_size(side, side, scans=scans))
    if words is None:
        assert result.scans == scans
    else:
        assert (result.code, words in result.message) == ("image_unreadable", True)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic_turn_agrees_with_libheif(inspect, orientation):
    stream = io.BytesIO()
    image = picture()
    image.getexif()[274] = orientation
    pillow_heif.from_pillow(image).save(stream, quality=80)
    facts = inspect(stream.getvalue())
    upright = (facts.height, facts.width) if facts.orientation > 4 else (facts.width, facts.height)
    assert facts.orientation == orientation
    assert pillow_heif.open_heif(stream.getvalue()).size == upright


def test_heic_is_mirrored_by_its_property_and_not_turned_by_exif(inspect):
    for turn, orientation in ((b"\0", 4), (b"\1", 2)):
        assert inspect(grid_heic(2, 2, 512, 0).replace(b"irot\0", b"imir" + turn)).orientation == orientation
    data = heic(exif=b"Exif\0\0" + exif_block(orientation=1))
    turned = data.replace(b"\x12\x01\x03\0\x01\0\0\0\x01\0", b"\x12\x01\x03\0\x01\0\0\0\x06\0")
    assert turned != data
    assert inspect(turned).orientation == 1


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"%PDF-1.7 and so on", "PDF"),
        (b"GIF89a and so on", "GIF"),
        (video(), "video"),
        (box(b"ftyp", b"avif\0\0\0\0mif1"), "AVIF"),
        (grid_heic(2, 2, 512).replace(b"grid", b"av01"), "AVIF"),
        (b"PK\3\4 and so on", "ZIP"),
        (b"\xff", "no photograph"),
        (b"", "no photograph"),
    ],
)
def test_file_of_another_kind_is_named(inspect, data, word):
    result = inspect(data)
    assert code(result) == "not_an_image"
    assert word in result.message


@pytest.mark.parametrize(
    "options", [{}, {"lossless": True}, {"quality": 10, "exif": b"Exif\0\0" + exif_block(orientation=6)}]
)
def test_webp_of_every_coding_is_whole(inspect, options):
    facts = inspect(webp(**options))
    assert (facts.media_type, facts.width, facts.height) == ("image/webp", 96, 64)
    assert facts.orientation == (6 if "exif" in options else 1)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (animated_webp(), "animation"),
        (riff(), "no picture"),
        (riff(webp_chunk(b"EXIF", b"II*\0")), "no picture"),
        (riff(webp_chunk(b"VP8 ", b"\0" * 20)), "no header"),
        (riff(*[webp_chunk(b"VP8L", b"\x2f\0\0\0\0\0")] * 2), "more than one picture"),
    ],
)
def test_webp_that_is_no_photograph_is_refused(inspect, data, what):
    result = inspect(data)
    assert code(result) == "image_unreadable"
    assert what in result.message


@pytest.mark.parametrize(
    ("data", "start"),
    [
        (jpeg(), 8),
        (jpeg(progressive=True), 8),
        (png(), 8),
        (webp(exif=b"Exif\0\0" + exif_block()), 12),
        (heic(exif=b"Exif\0\0" + exif_block()), 16),
        (grid_heic(3, 2, 512), 16),
    ],
)
def test_every_cut_of_a_file_is_seen(inspect, data, start):
    assert {code(inspect(data[:length])) for length in range(start, len(data) - 1, 7)} == {"image_truncated"}


@pytest.mark.parametrize("data", [jpeg(), png(), heic(), webp()])
def test_trailing_bytes_are_no_damage(inspect, data):
    for trailer in (b"\0" * 100, b"SEFH and so on SEFT", jpeg(), jpeg()[:-50], video(), video()[:-9], b"\xff" * 9):
        assert inspect(data + trailer) == inspect(data)


def test_fill_bytes_before_markers_are_no_damage(inspect):
    data = jpeg()
    at = data.index(b"\xff\xdb")
    assert inspect(data[:at] + b"\xff" * 50 + data[at:]) == inspect(data)
    assert inspect(data[:-2] + b"\xff" * 50 + data[-2:]) == inspect(data)


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:2] + b"\xff\xd9",  # ends before a picture
        lambda data: data[:2] + data[data.index(b"\xff\xc0") :].replace(b"\xff\xc0\0\x11", b"\xff\xc0\0\1", 1),
        lambda data: data[:2] + segment(0xC0, b"\x08\0\0\0\0\3") + data[2:],  # no size
        lambda data: data[:2] + segment(0xC0, b"\x08\0\x10\0\x10\3") + data[2:],  # two frames
        lambda data: data.replace(b"\xff\xdb", b"\0\0\xff\xdb", 1),  # bytes between segments
        lambda data: data[:-2] + data,  # a start mark in the scan
    ],
)
def test_broken_jpeg_is_unreadable(inspect, damage):
    assert code(inspect(damage(jpeg()))) == "image_unreadable"


def test_png_with_pixels_or_header_altered_on_the_way_is_unreadable_and_one_with_a_broken_text_is_whole(inspect):
    data = bytearray(png())
    data[data.index(b"IDAT") + 40] ^= 1
    assert code(inspect(bytes(data))) == "image_unreadable"
    broken = bytearray(png_chunk(b"tEXt", b"Comment\0lunch"))
    broken[-1] ^= 1
    assert isinstance(inspect(png(bytes(broken))), PhotoFacts)
    data = bytearray(png())
    data[19] ^= 1  # the width; its checksum no longer fits
    assert code(inspect(bytes(data))) == "image_unreadable"
    assert code(inspect(png_module.SIGNATURE + png_chunk(b"IEND", b""))) == "image_unreadable"
    header = png_chunk(b"IHDR", struct.pack(">LL", 5, 5) + b"\x08\2\0\0\0")
    assert code(inspect(png_module.SIGNATURE + header + png_chunk(b"IEND", b""))) == "image_unreadable"


@pytest.mark.parametrize("kind", [b"acTL", b"fcTL", b"fdAT"])
def test_animated_png_is_unreadable(inspect, kind):
    assert code(inspect(png(png_chunk(kind, bytes(8))))) == "image_unreadable"


@pytest.mark.parametrize("kind", [b"pitm", b"iloc", b"iinf", b"iprp", b"ispe"])
def test_heic_without_a_needed_box_is_unreadable(inspect, kind):
    assert code(inspect(heic().replace(kind, b"free"))) == "image_unreadable"


def test_heic_item_outside_the_file_is_truncated_and_a_sequence_without_a_still_picture_unreadable(inspect):
    data = grid_heic(2, 2, 512)
    at = data.index(b"iloc") + 4 + 8 + 16 + 8  # the first tile's offset
    assert code(inspect(data[:at] + b"\x7f\xff\xff\xff" + data[at + 4 :])) == "image_truncated"
    assert code(inspect(box(b"ftyp", b"msf1\0\0\0\0hevc") + box(b"moov", bytes(20)))) == "image_unreadable"


@pytest.mark.slow
def test_too_many_boxes_of_a_heic_are_unreadable_and_end_the_reading(inspect):
    boxes = box(b"free", b"") * (heif.MAX_STEPS + 1)
    assert code(inspect(box(b"ftyp", b"heic\0\0\0\0mif1") + boxes)) == "image_unreadable"
    assert code(inspect(grid_heic(2, 2, 512) + boxes)) == "image_unreadable"


def test_items_that_claim_countless_extents_or_overlap_beyond_the_files_length_end_the_reading(inspect):
    # With fields of no width, extents take no bytes: 65,535 items of 65,535 extents fit into a small file.
    items = b"".join(struct.pack(">HHHH", number, 0, 0, 65_535) for number in range(2_000))
    iloc = box(b"iloc", b"\1\0\0\0\0\0" + struct.pack(">H", 2_000) + items)
    data = grid_heic(2, 2, 512)
    children = b"".join([iloc, box(b"iinf", bytes(6)), box(b"pitm", bytes(6)), box(b"iprp", b"")])
    bomb = data[:24] + box(b"meta", bytes(4) + children)
    result = inspect(bomb)
    assert code(result) == "image_unreadable"
    assert str(heif.MAX_STEPS) in result.message
    data = heic(exif=b"Exif\0\0" + exif_block(), xmp=b"<x/>")
    at = data.index(b"iloc")
    patched = bytearray(data)
    for item in range(1, 3):  # Exif and mime: offset 0, the whole file
        entry = at + 4 + 8 + item * 18
        assert patched[entry : entry + 2] == bytes([0, item + 1])
        patched[entry + 4 : entry + 8] = bytes(4)
        patched[entry + 14 : entry + 18] = len(data).to_bytes(4)
    assert code(inspect(bytes(patched))) == "image_unreadable"
