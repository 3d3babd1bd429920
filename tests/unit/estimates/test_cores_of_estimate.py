"""Whole estimates in processes of their own: the same on any number of cores, without SciPy or the database."""

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from app.children.cores import THREAD_VARIABLES

DEMO = Path(str(files("app"))) / "demo_data"
PROGRAM = """
import json, resource, sys
from pathlib import Path
from app.estimates.estimate_json import options_from_json
from app.estimates.run_estimate import run_estimate
from app.vision.marker_spec import DEFAULT_MARKER

photographs = dict(zip(("left", "right"), map(Path, sys.argv[2:])))
options = options_from_json({"marker": DEFAULT_MARKER, "camera": None, "hints": []})
answer, estimate = run_estimate(
    photographs, options, max_pixels=10**8, on_stage=lambda _: None, want_artefacts=True, cores=int(sys.argv[1])
)
value = answer.as_json()
del value["stages"], value["seconds"]
pictures = [[each.name, each.content.hex()] for each in estimate.artefacts]
others = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([value, pictures, others.ru_utime]))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks are used on Linux alone")
@pytest.mark.parametrize(
    ("photographs", "foods"),
    [
        (["rice_banana_kiwifruit/left.jpg", "rice_banana_kiwifruit/right.jpg"], 3),
        (["left.jpg"], 1),
    ],
)
def test_estimate_is_the_same_on_one_core_and_on_two(photographs, foods):
    runs = []
    for cores in ("1", "2"):
        command = [sys.executable, "-c", PROGRAM, cores, *(str(DEMO / name) for name in photographs)]
        environment = dict.fromkeys(THREAD_VARIABLES, "1") | {"PYTHONPATH": ":".join(sys.path)}
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300, env=environment)
        runs.append(json.loads(done.stdout))
    (one, pictures, seconds_beside), (two, pictures_of_two, seconds_beside_of_two) = runs
    assert len(one["items"]) == foods
    assert one == two
    assert pictures == pictures_of_two
    assert seconds_beside == 0.0
    assert seconds_beside_of_two > 0.0


@pytest.mark.slow
def test_plain_pair_is_measured_without_parts_of_scipy_or_the_database():
    pair = [str(files("app") / "demo_data" / f"{side}.jpg") for side in ("left", "right")]
    command = [sys.executable, "-X", "importtime", "-m", "app.cli", "estimate", "--json", *pair]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert {"cv2", "app.vision.shape.shape"} <= loaded
    assert {"scipy.linalg", "scipy.sparse", "scipy.special", "scipy.spatial", "scipy.optimize"}.isdisjoint(loaded)
    assert {"sqlalchemy", "fastapi"}.isdisjoint(loaded)
