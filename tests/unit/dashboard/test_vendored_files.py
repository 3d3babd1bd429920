"""What static/vendor has of others is what its README says, each with its licence (three.js: another test)."""

import hashlib
import pathlib
import re

import pytest

import app.dashboard

VENDOR = pathlib.Path(app.dashboard.__file__).parent / "static" / "vendor"
LISTED = dict(
    re.findall(r"^\| `([\w./-]+)` \|.*`([0-9a-f]{64})` \|$", (VENDOR / "README.md").read_text(), re.MULTILINE)
)


def test_every_file_is_listed_and_every_folder_has_its_licence():
    files = {path.relative_to(VENDOR).as_posix() for path in VENDOR.rglob("*.*") if path.suffix != ".md"}
    assert {name for name in files if not name.startswith("three/")} == set(LISTED)
    for name in LISTED:
        assert (VENDOR / name).with_name("LICENSE").is_file()


@pytest.mark.parametrize("name", sorted(LISTED))
def test_file_is_the_one_that_was_listed(name):
    assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == LISTED[name]


def test_folder_s_own_readme_tells_the_same_checksum():
    assert LISTED["natural-earth/land.json"] in (VENDOR / "natural-earth" / "README.md").read_text()
