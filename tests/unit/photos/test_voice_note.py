"""Which files are voice notes: sound alone, in WebM or MP4."""

import pytest

from app.core.errors import Failure
from app.photos.voice_note import inspect_voice_note, remove_note_metadata
from tests.support.photographs import pair
from tests.support.voice_notes import box, element, mp4, webm

PLACE = b"+47.6062-122.3321/"
TAGS = "1254c367"
OPEN = bytes.fromhex("01ffffffffffffff")


def without_metadata(tmp_path, content):
    """The file after removal, with what holds for every file checked: same length, same kind, idempotent."""
    kind = kind_of(tmp_path, content)
    path = tmp_path / "note"
    changed = remove_note_metadata(path, kind)
    left = path.read_bytes()
    assert changed is (left != content)
    assert (len(left), kind_of(tmp_path, left)) == (len(content), kind)
    assert remove_note_metadata(path, kind) is False
    return left


def kind_of(tmp_path, content):
    path = tmp_path / "note"
    path.write_bytes(content)
    return inspect_voice_note(path)


@pytest.mark.parametrize(
    ("content", "media_type"),
    [
        (webm(2, sound=b"opus"), "audio/webm"),
        (webm(2, is_open=False), "audio/webm"),
        (mp4(b"soun", sound=b"aac"), "audio/mp4"),
        (mp4(b"soun") + box(b"moof", b"fragment"), "audio/mp4"),
    ],
)
def test_sound_alone_is_a_voice_note_and_without_metadata_it_stays_byte_for_byte(tmp_path, content, media_type):
    assert kind_of(tmp_path, content) == media_type
    assert without_metadata(tmp_path, content) == content


@pytest.mark.parametrize(
    "content",
    [
        webm(2, 1),
        webm(),
        webm(2, doc_type=b"matroska"),
        mp4(b"soun", b"vide"),
        mp4(),
        mp4(b"soun")[:-9],
        bytes.fromhex("1a45dfa3") + bytes(64),
        b"\0\0\0\x08ftyp" + b"\0\0\0\x01moov" + bytes(8),
        pair()["left"],
    ],
)
def test_anything_else_is_refused(tmp_path, content):
    failure = kind_of(tmp_path, content)
    assert isinstance(failure, Failure)
    assert failure.code == "voice_note_unreadable"


def test_many_elements_and_deep_boxes_end(tmp_path):
    assert isinstance(kind_of(tmp_path, element("1a45dfa3", element("ec") * 20_000)), Failure)
    nested = b""
    for _ in range(2_000):
        nested = box(b"moov", nested)
    assert isinstance(kind_of(tmp_path, box(b"ftyp") + nested), Failure)


def mp4_with(*, in_file=b"", in_movie=b"", in_track=b"", in_fragment=b""):
    """An MP4 note with further boxes in these places."""
    media = box(b"mdia", box(b"hdlr", bytes(8) + b"soun" + bytes(12)))
    movie = box(b"moov", box(b"trak", media + in_track) + in_movie)
    return box(b"ftyp", b"iso5") + movie + in_file + box(b"moof", in_fragment) + box(b"mdat", b"aac")


@pytest.mark.parametrize("place", ["in_file", "in_movie", "in_track"])
@pytest.mark.parametrize("kind", [b"udta", b"meta", b"uuid"])
def test_metadata_of_mp4_are_free_boxes_without_coordinates(tmp_path, place, kind):
    content = mp4_with(**{place: box(kind, box(b"\xa9abc", PLACE))})
    expected = mp4_with(**{place: box(b"free", bytes(8 + len(PLACE)))})
    assert without_metadata(tmp_path, content) == expected


def test_metadata_box_with_a_long_length_is_freed_and_the_location_atom_of_a_fragment_goes_too(tmp_path):
    long = bytes.fromhex("00000001") + b"udta" + (16 + len(PLACE)).to_bytes(8) + PLACE
    left = without_metadata(tmp_path, mp4_with(in_movie=long))
    assert PLACE not in left
    assert bytes.fromhex("00000001") + b"free" + (16 + len(PLACE)).to_bytes(8) in left
    atom = box(b"\xa9xyz", bytes([0, len(PLACE), 0, 0]) + PLACE)
    assert PLACE not in without_metadata(tmp_path, mp4_with(in_fragment=atom))


@pytest.mark.parametrize("name", [TAGS, "1941a469"])
def test_metadata_of_webm_are_a_void_also_behind_a_cluster_of_unknown_length(tmp_path, name):
    cluster = bytes.fromhex("1f43b675") + OPEN + element("e7", b"\0") + element("a3", b"opus")
    content = webm(2) + cluster + element(name, PLACE) + cluster
    left = without_metadata(tmp_path, content)
    assert left == webm(2) + cluster + element("ec", bytes(3 + len(PLACE))) + cluster


@pytest.mark.parametrize("end", [element(TAGS, PLACE)[:-1], bytes.fromhex(TAGS) + OPEN + PLACE])
def test_note_whose_metadata_cannot_be_told_from_sound_is_refused_unchanged(tmp_path, end):
    kind_of(tmp_path, webm(2) + end)
    failure = remove_note_metadata(tmp_path / "note", "audio/webm")
    assert isinstance(failure, Failure)
    assert (tmp_path / "note").read_bytes() == webm(2) + end
