"""The pages' vendor folders hold what their READMEs list, each with its licence (three.js: another test)."""

import hashlib
import pathlib
import re

import pytest

import app

PACKAGE = pathlib.Path(app.__file__).parent
FOLDERS = [PACKAGE / page / "static" / "vendor" for page in ("dashboard", "capture")]


def listed_in(folder):
    """The files that a folder's README lists, with their checksums."""
    readme = (folder / "README.md").read_text()
    return dict(re.findall(r"^\| `([\w./-]+)` \|.*`([0-9a-f]{64})` \|$", readme, re.MULTILINE))


LISTED = [(folder / name, digest) for folder in FOLDERS for name, digest in sorted(listed_in(folder).items())]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.parent.parent.name)
def test_every_file_is_listed_and_every_folder_has_its_licence(folder):
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*") if path.suffix != ".md"}
    assert {name for name in files if not name.startswith("three/")} == set(listed_in(folder))
    for name in listed_in(folder):
        assert (folder / name).with_name("LICENSE").is_file()


@pytest.mark.parametrize(("path", "digest"), LISTED, ids=lambda value: getattr(value, "name", ""))
def test_file_is_the_one_that_was_listed(path, digest):
    assert hashlib.sha256(path.read_bytes()).hexdigest() == digest


def test_readme_of_the_land_tells_the_same_checksum():
    listed = listed_in(FOLDERS[0])
    assert listed["natural-earth/land.json"] in (FOLDERS[0] / "natural-earth" / "README.md").read_text()
