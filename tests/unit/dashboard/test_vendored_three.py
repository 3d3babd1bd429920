"""three.js is what its README says, and a browser loads it without an import map and from nowhere else."""

import hashlib
import pathlib
import re

import pytest

import app.dashboard

THREE = pathlib.Path(app.dashboard.__file__).parent / "static" / "vendor" / "three"
LISTED = re.compile(r"^\| `([\w.]+)` \| `[\w/.]+` \| `([0-9a-f]{64})` \|$", re.MULTILINE)


def listed():
    return dict(LISTED.findall((THREE / "README.md").read_text(encoding="utf-8")))


def test_every_script_is_listed():
    assert set(listed()) == {path.name for path in THREE.glob("*.js")}
    assert "MIT License" in (THREE / "LICENSE").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sorted(listed()))
def test_script_is_the_one_that_was_listed_and_imports_only_its_neighbours(name):
    content = (THREE / name).read_bytes()
    assert hashlib.sha256(content).hexdigest() == listed()[name]
    imported = re.findall(r'(?:\}from|import\(|import)"([^"]+)"', content.decode())
    assert all((THREE / path).is_file() and path.startswith("./") for path in imported)
