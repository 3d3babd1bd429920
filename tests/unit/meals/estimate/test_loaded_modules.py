"""What `tada estimate` loads: neither parts of SciPy for a plain pair, nor the database."""

import subprocess
import sys
from importlib.resources import files

import pytest


@pytest.mark.slow
def test_plain_pair_is_measured_without_parts_of_scipy_or_the_database():
    pair = [str(files("app") / "demo_data" / f"{side}.jpg") for side in ("left", "right")]
    command = [sys.executable, "-X", "importtime", "-m", "app.cli", "estimate", "--json", *pair]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert {"cv2", "app.vision.solids.shape"} <= loaded
    assert {"scipy.linalg", "scipy.sparse", "scipy.special", "scipy.spatial", "scipy.optimize"}.isdisjoint(loaded)
    assert {"sqlalchemy", "fastapi"}.isdisjoint(loaded)
