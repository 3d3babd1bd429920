"""The pages' vendor folders hold what their READMEs list, each with its licence, and three.js imports nothing else."""

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


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.parent.parent.name)
def test_every_file_is_listed_with_its_checksum_and_has_its_licence(folder):
    listed = listed_in(folder)
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*") if path.suffix != ".md"}
    assert {name for name in files if not name.startswith("three/")} == set(listed)
    for name, digest in listed.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name
        assert (folder / name).with_name("LICENSE").is_file()
    if "natural-earth/land.json" in listed:
        assert listed["natural-earth/land.json"] in (folder / "natural-earth" / "README.md").read_text()


def test_scripts_of_three_js_are_those_that_were_listed_and_import_only_their_neighbours():
    three = FOLDERS[0] / "three"
    rows = re.findall(
        r"^\| `([\w.]+)` \| `[\w/.]+` \| `([0-9a-f]{64})` \|$", (three / "README.md").read_text(), re.MULTILINE
    )
    assert dict(rows).keys() == {path.name for path in three.glob("*.js")}
    assert "MIT License" in (three / "LICENSE").read_text(encoding="utf-8")
    for name, digest in rows:
        content = (three / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == digest
        imported = re.findall(r'(?:\}from|import\(|import)"([^"]+)"', content.decode())
        assert all((three / path).is_file() and path.startswith("./") for path in imported)
