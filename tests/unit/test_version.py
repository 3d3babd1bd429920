"""One version for one program: when it is raised is in docs/development.md."""

import pathlib
import re

import pytest

import app

ROOT = pathlib.Path(__file__).parents[2]
RELEASES = re.findall(
    r"^## (\d+)\.(\d+)\.(\d+) \(\d{4}-\d\d-\d\d\)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
)
NEWEST = ".".join(RELEASES[0])


def test_version_is_the_newest_release_s_or_on_the_way_to_the_next_one():
    first = re.search(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1]
    if first == "Unreleased":
        major, minor, _ = map(int, RELEASES[0])
        assert app.__version__ in {f"{major}.{minor + 1}.0.dev0", f"{major + 1}.0.0.dev0"}
    else:
        assert app.__version__ == NEWEST
    assert sorted(RELEASES, key=lambda release: tuple(map(int, release)), reverse=True) == RELEASES


@pytest.mark.parametrize(
    "manifest", sorted((ROOT / "docker" / "kubernetes").rglob("*.yaml")), ids=lambda path: path.name
)
def test_manifests_name_the_newest_release(manifest):
    assert set(re.findall(r"tada-server:(\S+)", manifest.read_text())) <= {NEWEST}
