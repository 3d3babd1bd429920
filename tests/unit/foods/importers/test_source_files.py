"""Files of a release in a zip, in a folder or alone: lines, encodings, damage."""

import pytest

from app.foods.importers.source_files import ImportFileError, SourceFiles
from tests.unit.foods.importers.release_files import damage_member, write_folder, write_zip

FILES = {"a.csv": "id,name\n1,one\n2,two\n", "b.csv": "id\n1\n"}


def test_zip_folder_and_nested_folder_hold_the_same_files_and_checksum_which_another_byte_changes(tmp_path):
    folder = SourceFiles(write_folder(tmp_path / "folder", FILES))
    nested = SourceFiles(write_zip(tmp_path / "nested.zip", FILES, inside="release_2026/"))
    assert [*folder.lines("A.CSV", "utf-8")] == [*nested.lines("a.csv", "utf-8")]
    assert folder.checksum(FILES) == nested.checksum(FILES)
    first = SourceFiles(write_folder(tmp_path / "first", FILES))
    second = SourceFiles(write_folder(tmp_path / "second", {**FILES, "b.csv": "id\n2\n"}))
    assert first.checksum(FILES) != second.checksum(FILES)
    path = tmp_path / "table.csv"
    path.write_text("id\n7\n")
    assert [*SourceFiles(path).csv_rows("table.csv")] == [(("table.csv", 2), {"id": "7"})]


def test_missing_path_and_file_and_two_releases_in_one_folder_are_named(tmp_path):
    with pytest.raises(ImportFileError, match=r"nowhere.zip: there is no such file or folder"):
        SourceFiles(tmp_path / "nowhere.zip")
    files = SourceFiles(write_folder(tmp_path / "release", FILES))
    with pytest.raises(ImportFileError, match=r"release: it holds no c.csv"):
        files.require(["a.csv", "c.csv"])
    write_folder(tmp_path / "both" / "april", FILES)
    write_folder(tmp_path / "both" / "may", FILES)
    with pytest.raises(ImportFileError, match=r"a.csv more than once: .*april.*may"):
        SourceFiles(tmp_path / "both").require(["a.csv"])


def test_truncated_zip_is_refused_and_one_damaged_in_the_middle_names_the_file_in_it(tmp_path):
    path = write_zip(tmp_path / "release.zip", {"a.csv": "id,name\n" + "".join(f"{i},{i**3}\n" for i in range(2000))})
    truncated = tmp_path / "truncated.zip"
    for share in (0.02, 0.95):
        truncated.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        with pytest.raises(ImportFileError, match=r"truncated.zip: it is no zip file, or only a part of one"):
            SourceFiles(truncated)
    damage_member(path, "a.csv")
    with pytest.raises(ImportFileError, match=r"release.zip: a.csv in it cannot be unpacked"):
        [*SourceFiles(path).lines("a.csv", "utf-8")]


def test_other_encodings_are_refused_with_their_line(tmp_path):
    files = {
        "latin.csv": "id,name\n1,café\n".encode("cp1252"),
        "utf16.csv": "id,name\n1,a\n".encode("utf-16"),
        "utf8.txt": "plain\nµg\n".encode(),
        "nul.csv": b"id\n1\0\n",
    }
    found = SourceFiles(write_folder(tmp_path / "release", files))
    for name, encoding, message in (
        ("latin.csv", "utf-8", r"latin.csv, line 2: byte 0xe9 is not utf-8"),
        ("utf16.csv", "utf-8-sig", r"utf16.csv, line 1: byte 0xff is not utf-8"),
        ("utf16.csv", "cp1252", r"utf16.csv, line 1: it holds NUL bytes"),
        ("utf8.txt", "cp1252", r"utf8.txt, line 2: it is UTF-8"),
        ("nul.csv", "utf-8", r"nul.csv, line 2: it holds NUL bytes"),
    ):
        with pytest.raises(ImportFileError, match=message):
            [*found.lines(name, encoding)]


def rows(tmp_path, text, columns=("id",)):
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    return [*SourceFiles(path).csv_rows("t.csv", columns)]


def test_csv_rows_carry_the_line_that_they_end_in(tmp_path):
    found = rows(tmp_path, '\ufeffid,name\n1,"two\nlines"\n\n2,b\n')
    assert [(place.line, cells) for place, cells in found] == [
        (3, {"id": "1", "name": "two\nlines"}),
        (5, {"id": "2", "name": "b"}),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("number,name\n1,a\n", r"t.csv, line 1: no column id; there are number, name"),
        ("id,id\n1,2\n", r"t.csv, line 1: column id is there twice"),
        ("id,name\n1,a\n2\n", r"t.csv, line 3: 1 fields under 2 columns"),
        ('id,name\n1,"a\n', r"t.csv, line 2: no proper CSV"),
        ("", r"t.csv, line 1: no column id"),
    ],
)
def test_csv_that_does_not_hold_together_is_refused(tmp_path, text, message):
    with pytest.raises(ImportFileError, match=message):
        rows(tmp_path, text)
