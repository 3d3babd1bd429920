"""Taking the location out: nothing of it is left anywhere, everything else is byte for byte as it was."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import ExifTags, Image

from app.core.errors import Failure
from app.photos import gps, heif, location
from app.photos.byte_file import edit_bytes
from app.photos.gps import Location
from app.photos.inspect import PhotoFacts, inspect_photo
from app.photos.location import read_location, remove_location
from tests.support.photo_files import (
    FOCAL_35MM,
    LATITUDE,
    LONGITUDE,
    MAKE,
    MODEL,
    PLACE_WORDS,
    TAKEN_AT,
    XMP,
    box,
    coordinate_bytes,
    exif_block,
    exif_segment,
    extended_xmp_segments,
    grid_heic,
    heic,
    iptc_segment,
    jpeg,
    picture,
    png,
    png_chunk,
    png_itxt,
    segment,
    video,
    webp,
    webp_chunk,
    xmp_segment,
)

GPS_TEXTS = (b"2026:03:01\0", b"HYBRID-FIX", b"Hovde Hall")


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "photo"


def cleaned(path: Path, data: bytes) -> bytes:
    """The file after removal, with what holds for every file checked: same length, same facts, idempotent."""
    path.write_bytes(data)
    facts = inspect_photo(path)
    assert isinstance(facts, PhotoFacts)
    assert remove_location(path, facts) is True
    result = path.read_bytes()
    assert len(result) == len(data)
    assert result != data
    assert inspect_photo(path) == facts
    assert remove_location(path, facts) is False
    assert path.read_bytes() == result
    assert read_location(path, facts) is None
    return result


def unchanged(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    facts = inspect_photo(path)
    assert isinstance(facts, PhotoFacts)
    assert remove_location(path, facts) is False
    assert path.read_bytes() == data


def opened(data: bytes) -> Image.Image:
    if data[4:8] == b"ftyp":
        return pillow_heif.HeifImageFile(io.BytesIO(data))
    return Image.open(io.BytesIO(data))


def assert_only_the_location_went(before: bytes, after: bytes) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        old, new = opened(before), opened(after)
        np.testing.assert_array_equal(np.asarray(old), np.asarray(new))
        old_exif, new_exif = old.getexif(), new.getexif()
        assert old_exif.get_ifd(ExifTags.IFD.GPSInfo)
        assert not new_exif.get_ifd(ExifTags.IFD.GPSInfo)
        assert {tag: value for tag, value in old_exif.items() if tag != ExifTags.IFD.GPSInfo} == dict(new_exif)
        assert old_exif.get_ifd(ExifTags.IFD.Exif) == new_exif.get_ifd(ExifTags.IFD.Exif)
    assert (new_exif[ExifTags.Base.Make], new_exif[ExifTags.Base.Model]) == (MAKE, MODEL)
    assert new_exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] == FOCAL_35MM
    assert new_exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] == TAKEN_AT


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", [1, 6])
def test_only_the_gps_directory_of_a_jpeg_goes(path, order, orientation):
    data = jpeg(exif_segment(exif_block(order, orientation=orientation)), progressive=True)
    result = cleaned(path, data)
    assert_only_the_location_went(data, result)
    assert opened(result).getexif()[ExifTags.Base.Orientation] == orientation
    for gone in (*coordinate_bytes(order), *GPS_TEXTS):
        assert gone in data
        assert gone not in result


@pytest.mark.parametrize("order", ["<", ">"])
def test_only_the_location_of_a_png_a_heic_and_a_webp_goes(path, order):
    block = exif_block(order, orientation=6)
    files = {
        "png": png(png_chunk(b"eXIf", block), png_itxt(XMP)),
        "heic": heic(exif=b"Exif\0\0" + exif_block(order), xmp=XMP),
        "webp": webp(exif=b"Exif\0\0" + block, xmp=XMP),
    }
    for kind, data in files.items():
        result = cleaned(path, data)
        assert_only_the_location_went(data, result)
        assert not any(gone in result for gone in (*coordinate_bytes(order), *GPS_TEXTS, *PLACE_WORDS))
        assert b'xmp:Rating="3"' in result
        if kind != "heic":
            assert opened(result).getexif()[ExifTags.Base.Orientation] == 6
        if kind == "png":  # its checksum fits
            start = result.index(b"eXIf")
            end = start + 4 + int.from_bytes(result[start - 4 : start])
            assert zlib.crc32(result[start:end]) == int.from_bytes(result[end : end + 4])


def test_a_photograph_without_location_is_not_touched(path):
    plain_xmp = XMP.replace(b"exif:GPSL", b"exif:Plat").replace(b"City", b"Town").replace(b":State", b":Xtate")
    plain_xmp = plain_xmp.replace(b"LocationShown", b"PersonShownXx").replace(b"Sublocation", b"Subtraction")
    block = exif_block(gps=False, thumbnail=jpeg(exif_segment(exif_block(gps=False))))
    unchanged(path, jpeg(exif_segment(block), xmp_segment(plain_xmp), icc_profile=b"GPSInfo Latitude", trailer=jpeg()))
    unchanged(path, png(png_chunk(b"eXIf", block), png_itxt(plain_xmp), png_chunk(b"tEXt", b"Title\0lunch")))
    unchanged(path, heic(exif=b"Exif\0\0" + exif_block(gps=False), xmp=plain_xmp))


def test_preview_and_secondary_pictures_lose_their_location_too(path):
    preview = jpeg(exif_segment(exif_block(">")))
    data = jpeg(exif_segment(exif_block("<", thumbnail=preview)), trailer=b"gap" + jpeg(exif_segment(exif_block(">"))))
    result = cleaned(path, data)
    assert_only_the_location_went(data, result)
    assert not any(gone in result for order in "<>" for gone in (*coordinate_bytes(order), *GPS_TEXTS))
    second = result[result.index(b"\xff\xd9gap") + 5 :]
    assert_only_the_location_went(data[-len(second) :], second)


def test_exif_that_runs_over_two_segments_is_cleaned_as_one(path):
    block = exif_block()
    for cut in range(8, len(block), 9):
        data = jpeg(exif_segment(block[:cut]), exif_segment(block[cut:]))
        assert_only_the_location_went(data, cleaned(path, data))


@pytest.mark.parametrize("cut", [40, 300, 420, 700])
def test_extended_xmp_over_two_segments_is_cleaned_as_one(path, cut):
    result = cleaned(path, jpeg(*extended_xmp_segments(XMP, cut)))
    assert not any(word in result for word in PLACE_WORDS)
    assert b'xmp:Rating="3"' in result.replace(extended_xmp_segments(b"", 0)[0][:60], b"") or cut == 420
    assert opened(result).size == opened(jpeg()).size


def test_extended_xmp_with_a_part_missing_and_xmp_in_wide_characters_go_whole(path):
    result = cleaned(path, jpeg(extended_xmp_segments(XMP, 420)[1]))
    assert not any(word in result for word in PLACE_WORDS)
    for coding in ("utf-16-le", "utf-16-be", "utf-32-le"):
        result = cleaned(path, jpeg(xmp_segment(XMP.decode().encode(coding))))
        assert not any(word.decode().encode(coding) in result for word in PLACE_WORDS)


def test_places_in_iptc_and_xmp_go_and_the_rest_stays(path):
    result = cleaned(path, jpeg(iptc_segment()))
    assert not any(word in result for word in PLACE_WORDS)
    assert b"apple and rice" in result
    from PIL import IptcImagePlugin

    told = IptcImagePlugin.getiptcinfo(opened(result))
    assert told[2, 120] == b"apple and rice"
    assert not told[2, 90].strip()
    result = cleaned(path, jpeg(xmp_segment(XMP)))
    assert not any(word in result for word in PLACE_WORDS)
    description = opened(result).getxmp()["xmpmeta"]["RDF"]["Description"]
    assert {key: value for key, value in description.items() if key != "about"} == {"Rating": "3", "Label": "lunch"}


@pytest.mark.parametrize("compressed", [False, True])
def test_xmp_of_a_png_is_cleaned_or_if_compressed_goes_whole(path, compressed):
    result = cleaned(path, png(png_itxt(XMP, compressed=compressed)))
    assert not any(word in result for word in PLACE_WORDS)
    assert zlib.compress(XMP) not in result
    assert (b'xmp:Rating="3"' in result) is not compressed
    np.testing.assert_array_equal(np.asarray(opened(result)), np.asarray(picture()))


@pytest.mark.parametrize("keyword", [b"Raw profile type exif", b"exif:GPSLatitude", b"Location"])
@pytest.mark.parametrize("kind", [b"tEXt", b"zTXt"])
def test_png_text_that_holds_metadata_goes_whole(path, keyword, kind):
    text = exif_block().hex().encode()
    data = png(png_chunk(kind, keyword + b"\0" + (b"\0" + zlib.compress(text) if kind == b"zTXt" else text)))
    image = opened(cleaned(path, data))
    image.load()
    assert image.info["Comment"].strip() == ""
    assert not image.getexif()


def test_appended_video_loses_its_location_atoms(path):
    clip = video()
    for data in (
        jpeg(trailer=clip),
        png() + clip,
        heic() + box(b"mpvd", clip),
        heic() + clip[clip.index(b"moov") - 4 :],
    ):
        result = cleaned(path, data)
        assert not any(gone in result for gone in (b"+40.42", b"-086.9", b"Hovde Hall", struct.pack(">l", 2649464)))
        np.testing.assert_array_equal(np.asarray(opened(data)), np.asarray(opened(result)))


def test_samsung_trailer_loses_blocks_that_speak_of_coordinates(path):
    def block(kind, name, content):
        return struct.pack("<HHL", 0, kind, len(name)) + name + content

    blocks = [
        block(0x0A01, b"Image_UTC_Data", b"1772366400000"),
        block(0x0B00, b"Scene_Data", b'{"latitude":40.428158,"longitude":-86.913647}'),
    ]
    entries, distance = b"", sum(map(len, blocks))
    for kind, one in zip((0x0A01, 0x0B00), blocks, strict=True):
        entries += struct.pack("<HHLL", 0, kind, distance, len(one))
        distance -= len(one)
    directory = b"SEFH" + struct.pack("<LL", 106, 2) + entries
    trailer = b"".join(blocks) + directory + struct.pack("<L", len(directory)) + b"SEFT"
    result = cleaned(path, jpeg(trailer=trailer))
    assert b"40.428158" not in result
    assert b"Image_UTC_Data1772366400000" in result


def test_blocks_of_unknown_form_that_speak_of_coordinates_go_whole(path):
    claim = b'jumb c2pa {"exif:GPSLatitude": "40,25.6895N"}'
    for data in (
        jpeg(segment(0xEB, b"JP\0\1" + claim)),
        jpeg(segment(0xFE, b"Latitude=40,25.6895N")),
        png(png_chunk(b"caBX", claim)),
        heic() + box(b"uuid", bytes(16) + claim),
    ):
        assert b"40,25.6895N" not in cleaned(path, data)
    data, more = webp(), webp_chunk(b"GEO ", claim)
    size = int.from_bytes(data[4:8], "little") + len(more)
    assert b"40,25.6895N" not in cleaned(path, data[:4] + size.to_bytes(4, "little") + data[8:] + more)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda block, gps, code: put(block, gps, b"\xff\xff"), id="gps directory longer than the block"),
        pytest.param(lambda block, gps, code: put(block, gps + 2 + 24 + 2, code(99)), id="gps value of unknown type"),
        pytest.param(lambda block, gps, code: put(block, gps + 2 + 24 + 6, b"\x7f\x7f"), id="gps value out of bounds"),
        pytest.param(lambda block, gps, code: block[: len(block) - 40], id="gps values cut"),
        pytest.param(lambda block, gps, code: put(block, 4, b"\0\0\0\0"), id="no main directory"),
    ],
)
def test_exif_that_cannot_be_read_whole_is_reduced_to_its_orientation(path, order, spoil):
    block = exif_block(order, orientation=6)
    gps = len(exif_block(order, gps=False)) + 12
    byte_order = "little" if order == "<" else "big"
    assert int.from_bytes(block[gps : gps + 2], byte_order) == 11
    spoilt = spoil(block, gps, lambda number: number.to_bytes(2, byte_order))
    path.write_bytes(jpeg(exif_segment(spoilt)))
    orientation = inspect_photo(path).orientation
    result = cleaned(path, jpeg(exif_segment(spoilt)))
    assert dict(opened(result).getexif()) == ({ExifTags.Base.Orientation: 6} if orientation == 6 else {274: 1})
    assert not any(gone in result for gone in (*coordinate_bytes(order), *GPS_TEXTS))


def test_bytes_that_a_thousand_gps_entries_share_are_zeroed_once(monkeypatch):
    """A WebP of such entries over 30 MB held the server for 28 s."""
    size, count = 100_000, 1000
    entries = struct.pack("<HHLL", 2, 7, size - 20_000, 20_000) * count
    block = b"II*\0\x08\0\0\0" + struct.pack("<HHHLLL", 1, 0x8825, 4, 1, 26, 0) + struct.pack("<H", count) + entries
    zeroed = []
    merged = gps.merged
    monkeypatch.setattr(gps, "merged", lambda extents: zeroed.extend(merged(extents)) or zeroed)
    result = gps.without_gps(block.ljust(size, b"x"))
    assert (len(result), result[:4], b"x" in result[20_000:]) == (size, b"II*\0", False)
    assert sum(end - start for start, end in zeroed) <= size


def test_items_of_a_heic_are_not_compared_with_each_packet(path):
    compared = []

    class Compared(tuple):
        __slots__ = ()
        __hash__ = tuple.__hash__

        def __eq__(self, other):
            compared.append(other)
            return super().__eq__(other)

    kinds = [b"application/rdf+xml", b"text/plain"] * 50
    items = tuple(heif.HeifItem(b"mime", kind, (Compared((at, at + 1)),)) for at, kind in enumerate(kinds))
    path.write_bytes(bytes(100))
    with edit_bytes(path) as edits:
        location._clean_heif(edits, heif.HeifLayout(items=items))
    assert not compared


def put(block: bytes, at: int, replacement: bytes) -> bytes:
    return block[:at] + replacement + block[at + len(replacement) :]


def test_xmp_that_goes_whole_keeps_the_orientation(path):
    packet = XMP.replace(b'xmp:Rating="3"', b'tiff:Orientation="6" <').replace(b"\n", b" ")
    result = cleaned(path, jpeg(xmp_segment(packet)))  # cleaned() checks that the facts are the same
    assert opened(result).getexif()[ExifTags.Base.Orientation] == 6
    assert not any(word in result for word in PLACE_WORDS)


@pytest.mark.parametrize("order", ["<", ">"])
def test_location_is_read_in_degrees(path, order):
    block = exif_block(order)
    for data in (jpeg(exif_segment(block)), png(png_chunk(b"eXIf", block)), heic(exif=b"Exif\0\0" + block)):
        path.write_bytes(data)
        location = read_location(path, inspect_photo(path))
        assert location == Location(pytest.approx(LATITUDE), pytest.approx(LONGITUDE))


def test_location_that_makes_no_sense_is_none_and_of_an_emptied_file_nothing_is_removed(path):
    for old, new in (
        (struct.pack("<LL", 40, 1), struct.pack("<LL", 140, 1)),  # beyond the pole
        (struct.pack("<LL", 40, 1), struct.pack("<LL", 40, 0)),  # divided by zero
        (b"\1\0\2\0\2\0\0\0N\0", b"\1\0\2\0\2\0\0\0?\0"),  # no hemisphere
        (b"".join(coordinate_bytes()[:1]), struct.pack("<6L", 0, 0, 0, 0, 0, 0)),  # unset
    ):
        block = exif_block()
        assert old in block
        path.write_bytes(jpeg(exif_segment(block.replace(old, new))))
        assert read_location(path, inspect_photo(path)) is None
    path.write_bytes(b"")
    assert remove_location(path, PhotoFacts("image/jpeg", 1, 1, 1, 1)) is False
    assert read_location(path, PhotoFacts("image/jpeg", 1, 1, 1, 1)) is None


VALID = (
    jpeg(exif_segment(exif_block("<", orientation=6)), trailer=jpeg()),
    jpeg(exif_segment(exif_block(">")), progressive=True),
    jpeg(xmp_segment(XMP), iptc_segment(), *extended_xmp_segments(XMP, 400), trailer=video()),
    png(png_chunk(b"eXIf", exif_block()), png_itxt(XMP)),
    heic(exif=b"Exif\0\0" + exif_block(), xmp=XMP),
    grid_heic(3, 2, 512, 1),
)


@st.composite
def corrupted(draw) -> bytes:
    """A valid file with some bytes replaced, cut out or put in, and perhaps its end cut off."""
    data = bytearray(draw(st.sampled_from(VALID)))
    for _ in range(draw(st.integers(1, 8))):
        at = draw(st.integers(0, len(data)) | st.integers(0, min(900, len(data))))
        removed = draw(st.sampled_from([0, 1, 1, 1, 2, 4, 30]))
        data[at : at + removed] = draw(st.binary(max_size=4) | st.sampled_from([b"\0", b"\xff", b"\xff\xff\xff\xff"]))
    return bytes(data[: draw(st.just(len(data)) | st.integers(0, len(data)))])


@pytest.mark.slow
@settings(max_examples=600, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=corrupted())
def test_removal_never_raises_never_changes_the_length_and_leaves_the_facts(path, data):
    path.write_bytes(data)
    facts = inspect_photo(path)
    if isinstance(facts, Failure):
        for media_type in ("image/jpeg", "image/png", "image/heic"):
            path.write_bytes(data)
            remove_location(path, PhotoFacts(media_type, 1, 1, 1, 1))
            assert path.stat().st_size == len(data)
        return
    remove_location(path, facts)
    assert path.stat().st_size == len(data)
    assert inspect_photo(path) == facts
    assert read_location(path, facts) is None


def test_heic_metadata_in_idat_go(path):
    """Construction method 1: the item lies in the meta box itself."""
    block = b"\0\0\0\6Exif\0\0" + exif_block()
    data = heic(exif=b"Exif\0\0" + exif_block(gps=False))
    meta_at = data.index(b"meta") - 4
    meta_end = meta_at + int.from_bytes(data[meta_at : meta_at + 4])
    meta = bytearray(data[meta_at:meta_end])
    iloc = meta.index(b"iloc") + 4
    count = int.from_bytes(meta[iloc + 6 : iloc + 8])
    items = [meta[iloc + 8 + index * 18 : iloc + 26 + index * 18] for index in range(count)]
    old_size, grown = 16 + count * 18, 2 * count + 8 + len(block)
    moved = bytearray()
    for item in items:
        item_id, _, base, extents, offset, length = struct.unpack(">HHLHLL", item)
        place = (1, 0, 0, extents, 0, len(block)) if item_id == 2 else (0, 0, base + grown, extents, offset, length)
        moved += struct.pack(">HHHLHLL", item_id, *place)
    new_iloc = box(b"iloc", b"\1\0\0\0\x44\x40" + count.to_bytes(2) + moved)
    meta[iloc - 8 : iloc - 8 + old_size] = new_iloc
    content = bytes(meta[8:]) + box(b"idat", block)
    data = data[:meta_at] + box(b"meta", content) + data[meta_end:]
    assert_only_the_location_went(data, cleaned(path, data))
