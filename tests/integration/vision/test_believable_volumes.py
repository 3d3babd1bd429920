"""Every bundled pair and six development scenes, with hints drawn by a seed: no volume that nobody may believe."""

import importlib.resources
import json
import pathlib
import random

import cv2
import numpy as np
import pytest

from app.cli.demo import PLATES as BY_NAME
from app.meals.estimate.estimate_files import estimate_files, read_options

SEED = 39
PLATES = {plate.folder or "apple": plate for plate in BY_NAME.values()}
SCENES = ("meal-04", "meal-09", "meal-12", "table-03", "table-06", "hard-01-touching")
PLAUSIBLE_ML = {  # what a person may have on the plate, from half of a small one to two large ones
    "apple": (40, 600),
    "banana": (40, 500),
    "bread-white": (20, 500),
    "cake-yellow": (40, 600),
    "doughnut": (25, 300),
    "egg-boiled": (20, 160),
    "kiwifruit": (25, 300),
    "orange": (40, 600),
    "pear": (50, 700),
    "potato-baked": (50, 700),
    "potato-mashed": (30, 800),
    "rice-white-cooked": (30, 800),
    "salad-greens": (30, 900),
}
KEYS = {  # of the starter table, by the renderer's names
    "bread, slice": "bread-white",
    "cake, slice": "cake-yellow",
    "egg, boiled": "egg-boiled",
    "green apple": "apple",
    "mashed potato": "potato-mashed",
    "potato, baked": "potato-baked",
    "rice, cooked": "rice-white-cooked",
    "salad greens": "salad-greens",
}


def estimate(folder, marker, hints):
    options = read_options(marker=marker, camera=None, method="shape", hints=[json.dumps(hint) for hint in hints])
    photographs = [folder / "left.jpg", folder / "right.jpg"]
    return estimate_files(photographs, options, max_pixels=10**8, debug=None, on_stage=None)


def require_believable(answer, hints):
    assert answer["failure"] is None
    by_hint = {item["hint"]: item for item in answer["items"]}
    for number, hint in enumerate(hints):
        item = by_hint[number]
        if item["volume_ml"] is None:
            assert "not_measurable" in item["flags"]
            continue
        low, high = item["volume_interval_ml"]
        assert item["volume_ml"] / 3 < low < high < 3 * item["volume_ml"], hint
        least, most = PLAUSIBLE_ML[hint["food"]]
        assert least < item["volume_ml"] < most, hint


@pytest.mark.parametrize("moved_px", [0, pytest.param(12, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", PLATES)
def test_bundled_pair_has_believable_volumes(name, moved_px):
    plate, draw = PLATES[name], random.Random(f"{SEED} {name}")
    hints = []
    for food, (x, y) in plate.points.items():
        point = [x + draw.randint(-moved_px, moved_px), y + draw.randint(-moved_px, moved_px)]
        hints.append({"point": point, "food": food})
    folder = pathlib.Path(str(importlib.resources.files("app"))) / "demo_data" / plate.folder
    require_believable(estimate(folder, "plain:9x7:11", hints), hints)


@pytest.mark.parametrize("name", [SCENES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in SCENES[1:])])
def test_development_scene_has_believable_volumes(shared_data, name):
    draw = random.Random(f"{SEED} {name}")
    folder = next((shared_data / "scenes" / "dev").glob(f"*/{name}"))
    truth = json.loads((folder / "truth.json").read_text())
    labels = cv2.imread(str(folder / "left_items.png"), cv2.IMREAD_GRAYSCALE)
    hints = []
    for number, item in enumerate(truth["items"], start=1):
        food = KEYS.get(item["food"], item["food"])
        if food in PLAUSIBLE_ML:
            hints.append(hint_in(labels == number, draw) | {"food": food})
    marker = truth["marker"]
    spec = f"{marker['kind']}:{marker['cols']}x{marker['rows']}:{marker['square_mm']:g}"
    require_believable(estimate(folder, spec, hints), hints)


def hint_in(mask, draw):
    """A point well within the food, or the box around it."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    if draw.random() < 0.3:
        return {"box": [x, y, width, height]}
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    rows, columns = np.nonzero(depth > depth.max() / 2)
    drawn = draw.randrange(len(rows))
    return {"point": [int(columns[drawn]), int(rows[drawn])]}
