"""Real photographs with volumes known by photogrammetry: which pairs there are, and how far their volumes are off.

A folder with cases.json (name, truth_ml, card, hint in the left photograph, photographs with the card drawn in, and
camera or rig) -> one row per pair, in the shape of the scorer's rows. Photographs of one object on an ArUco sheet are
combined to every pair whose lines of sight differ by VIEW_ANGLES_DEG; what a scene has beside the object is not known,
so there is no outline to compare with. The folder's own cases on such a sheet are measured by the sheet itself too.
"""

import itertools
import json
import shlex
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

VIEW_ANGLES_DEG = (
    3.0,
    40.0,
)  # nearer, and parallax tells little; farther, and views show different sides
MOST_MEAN_ERROR_PERCENT = 6.0
COVERAGE_PERCENT = (85.0, 95.0)
TIMEOUT_S = 120


@dataclass(frozen=True)
class RealPair:
    """Two photographs of one object, with the marker drawn in, and the camera that took them."""

    name: str
    truth_ml: float
    left: Path
    right: Path
    marker: str
    point: tuple[float, float]
    camera: Mapping[str, Any]


def real_pairs(folder: Path) -> list[RealPair]:
    """The folder's own cases and the further combinations of photographs on ArUco sheets; none where it is absent."""
    if not (folder / "cases.json").is_file():
        return []
    cases = json.loads((folder / "cases.json").read_text())
    pairs = [
        _pair(folder, case, case["left_card"], case["right_card"], case["name"]) for case in cases
    ]
    on_sheet = [case for case in cases if "aruco" in case]
    pairs += [
        replace(
            _pair(folder, case, case["left"], case["right"], f"{case['name']} sheet"),
            marker=_sheet_text(case),
        )
        for case in on_sheet
    ]
    photographs = sorted({case[side] for case in on_sheet for side in ("left", "right")})
    centres = {name: _centre_mm(folder, name, on_sheet[0]) for name in photographs}
    combined = {frozenset((case["left"], case["right"])) for case in on_sheet}
    for case, right in itertools.product(on_sheet, photographs):
        both = frozenset((case["left"], right))
        if (
            len(both) == 2
            and both not in combined
            and _is_usable(centres[case["left"]], centres[right])
        ):
            combined.add(both)
            cards = case["left_card"], f"{Path(right).stem}_card.jpg"
            pairs.append(
                _pair(folder, case, *cards, f"{Path(case['left']).stem} {Path(right).stem}")
            )
    return pairs


def measure(pair: RealPair, command: str, camera: str, method: str) -> dict[str, Any]:
    """One row as the scorer makes them. camera: "calibrated" or "exif", which these photographs have none of."""
    arguments = [
        *shlex.split(command),
        str(pair.left),
        str(pair.right),
        "--json",
        "--method",
        method,
    ]
    arguments += ["--marker", pair.marker, "--hint", json.dumps({"point": pair.point})]
    with tempfile.NamedTemporaryFile("w", suffix=".json") as camera_file:
        json.dump(pair.camera, camera_file)
        camera_file.flush()
        if camera == "calibrated":
            arguments += ["--camera", camera_file.name]
        done = subprocess.run(
            arguments, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    try:
        answer = json.loads(done.stdout)
    except json.JSONDecodeError:
        answer = {"items": [], "failure": {"code": "no_answer"}}
    measured = [item for item in answer["items"] if item["volume_ml"]]
    volume_ml, interval = (
        (measured[0]["volume_ml"], measured[0]["volume_interval_ml"]) if measured else (None, None)
    )
    return {
        "scene": pair.name,
        "true_ml": pair.truth_ml,
        "ml": volume_ml,
        "interval": interval,
        "error": None if volume_ml is None else volume_ml / pair.truth_ml - 1,
        "inside": interval is not None and interval[0] <= pair.truth_ml <= interval[1],
        "flags": measured[0]["flags"] if measured else [],
        "failure": (answer.get("failure") or {}).get("code"),
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Percent, over the pairs that were measured (a refused pair misleads nobody), and how many these are."""
    errors = np.array([row["error"] for row in rows if row["error"] is not None])
    if len(errors) == 0:
        return {"pairs": len(rows), "measured": 0}
    inside = [row["inside"] for row in rows if row["error"] is not None]
    return {
        "pairs": len(rows),
        "measured": len(errors),
        "mean_error": 100 * float(np.abs(errors).mean()),
        "median_error": 100 * float(np.median(np.abs(errors))),
        "worst": 100 * float(np.abs(errors).max()),
        "bias": 100 * float(errors.mean()),
        "coverage": 100 * float(np.mean(inside)),
    }


def _pair(folder: Path, case: Mapping[str, Any], left: str, right: str, name: str) -> RealPair:
    described = json.loads((folder / case.get("camera", case.get("rig", ""))).read_text())
    if "left" in described:  # a rig's two cameras, undistorted to the same
        described = {key: described[key] for key in ("width", "height")} | described["left"]
    x, y = case["hint"]["point"]
    return RealPair(
        name, case["truth_ml"], folder / left, folder / right, case["card"], (x, y), described
    )


def _sheet_text(case: Mapping[str, Any]) -> str:
    """The ArUco sheet under the object as `tada estimate --marker` takes it."""
    sheet = case["aruco"]
    size = f"{sheet['cols']}x{sheet['rows']}:{sheet['marker_mm']:g}:{sheet['separation_mm']:g}"
    return f"aruco:{size}:{sheet['dictionary']}"


def _centre_mm(folder: Path, photograph: str, case: Mapping[str, Any]) -> NDArray[np.float64]:
    """(3,) the camera's centre from the middle of the ArUco sheet."""
    sheet, camera = case["aruco"], json.loads((folder / case["camera"]).read_text())
    tags = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, sheet["dictionary"]))
    size = (sheet["cols"], sheet["rows"])
    board = cv2.aruco.GridBoard(size, sheet["marker_mm"], sheet["separation_mm"], tags)
    corners, ids, _ = cv2.aruco.ArucoDetector(tags).detectMarkers(
        cv2.imread(str(folder / photograph))
    )
    points, pixels = board.matchImagePoints(corners, ids)
    matrix = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]])
    _, turn, translation = cv2.solvePnP(points, pixels, matrix, np.array(camera["distortion"]))
    pitch_mm = sheet["marker_mm"] + sheet["separation_mm"]
    middle = np.array([*(pitch_mm * np.array(size) / 2), 0.0])
    return np.asarray(-cv2.Rodrigues(turn)[0].T @ translation.ravel() - middle, np.float64)


def _is_usable(centre: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    cosine = centre @ other / (np.linalg.norm(centre) * np.linalg.norm(other))
    return bool(VIEW_ANGLES_DEG[0] < np.degrees(np.arccos(cosine)) < VIEW_ANGLES_DEG[1])
