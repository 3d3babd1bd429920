"""`tada demo` from an installed wheel, far from the checkout: migrations, demo pair and food table are inside."""

import os
import re
import subprocess
import sys

import pytest

from tests.e2e.processes import REPOSITORY

PICTURES = ("matches", "rectified", "disparity", "slices", "overlay")


@pytest.mark.slow
def test_demo_runs_from_an_installed_wheel(tmp_path):
    wheels, installed = tmp_path / "wheels", tmp_path / "installed"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(wheels), str(REPOSITORY)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = wheels.iterdir()
    subprocess.run(
        [*pip, "install", "--no-deps", "--target", str(installed), str(wheel)], check=True, capture_output=True
    )
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    environment["PYTHONPATH"] = str(installed)
    where = subprocess.run(
        [sys.executable, "-c", "import app; print(app.__file__)"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert where.stdout.startswith(str(installed)), "the checkout was used, not the wheel"
    done = subprocess.run(
        [sys.executable, "-m", "app.cli", "demo", "-o", str(tmp_path / "pictures")],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    volume_ml = float(re.search(r"volume\s+([\d.]+) ml", done.stdout)[1])
    assert 100 < volume_ml < 300, done.stdout  # an apple; how exact it is, the benchmark tells
    assert re.search(r"processing: \w+", done.stdout), "a run of a second or two shows some of its stages"
    assert re.search(r"\d\d\.\d%  Apple", done.stdout), "the apple is seen to be one"
    for word in ("mass", "Energy", "edible", "needs_review", "confirmed"):
        assert word in done.stdout
    written = {path.name for path in (tmp_path / "pictures").iterdir()}
    for name in PICTURES:
        assert any(name in file for file in written), written
    assert any(file.endswith(".ply") for file in written)
