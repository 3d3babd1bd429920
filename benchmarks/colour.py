"""How near the colour board's squares come to their printed colours, on rendered pairs whose poses are known.

    python benchmarks/colour.py [--scenes meals] [--data FOLDER]

For each photograph with a colour board the CIEDE2000 of each square: as taken, by white balance and exposure alone,
corrected, and corrected by a fit that left this square out. Measured on the finished pictures, bytes and all, over two
thirds of each square, placed by the scene's true pose and not by the corners that the fit used. Below: what shadows
over the board bring about, judged on the photograph without the shadow.
FOLDER (default: TADA_SHARED_DATA, or ../shared) holds scenes/dev/.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.core.errors import Failure  # noqa: E402  # found from the checkout, installed or not
from app.vision.board.ciede2000 import ciede2000  # noqa: E402
from app.vision.board.colour_correction import apply_colour, measure_colour  # noqa: E402
from app.vision.board.colour_fit import PAPER_WHITE, fit_matrix, reference_linear  # noqa: E402
from app.vision.board.colour_samples import find_white, sample_board  # noqa: E402
from app.vision.board.colour_space import LINEAR_OF_BYTE, encode_srgb, lab_of, linear_rgb  # noqa: E402
from app.vision.board.grid import grid_homography, map_points  # noqa: E402
from app.vision.board.marker import find_marker  # noqa: E402
from app.vision.marker_spec import COLOUR_SQUARES, parse_marker  # noqa: E402
from app.vision.model import ColourCorrection, MarkerObservation, Photo  # noqa: E402
from app.vision.photograph.photo import read_photo  # noqa: E402

NAMES = (
    "cyan",
    "red",
    "olive",
    "black",
    "magenta",
    "green",
    "orange",
    "dark red",
    "yellow",
    "blue",
)
SHEET_MM = 0.3  # over the table
SHADOW = 0.3  # of the light that is left
SHADOWS: dict[
    str, Callable[[Any, Any], Any]
] = {  # x, y in squares from the board's top left corner -> its share
    "half, hard": lambda x, _: x < 1.5,
    "half, soft": lambda x, _: np.clip((2.0 - x) / 2.0 + 0.5, 0.0, 1.0),
    "corner": lambda x, y: (x < 1.6) & (y < 1.6),
    "slanting": lambda x, y: x / 4 + y / 5 < 1.0,
    "all of it": lambda x, _: np.ones(x.shape),
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--scenes", default="meals", help="folder under scenes/dev, or a folder of scenes"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args(arguments)
    folder = (
        Path(options.scenes)
        if Path(options.scenes).is_dir()
        else options.data / "scenes" / "dev" / options.scenes
    )
    boards = [
        path.parent for path in sorted(folder.glob("*/truth.json")) if marker_kind(path) == "colour"
    ]
    if not boards:
        print(
            f"There are no colour boards in {folder}: give --data FOLDER or set TADA_SHARED_DATA.",
            file=sys.stderr,
        )
        return 2
    cv2.setNumThreads(1)
    found = [
        (f"{board.name} {side}", board, side) for board in boards for side in ("left", "right")
    ]
    print_squares(found)
    print_shadows(found)
    return 0


def marker_kind(truth: Path) -> str:
    return str(json.loads(truth.read_text())["marker"]["kind"])


def read_board(folder: Path, side: str) -> tuple[Photo, MarkerObservation]:
    photo = read_photo((folder / f"{side}.jpg").read_bytes(), max_pixels=10**8)
    if isinstance(photo, Failure):
        raise TypeError(photo.message)
    marker = find_marker(photo, parse_marker("colour:4x5:12"))
    if isinstance(marker, Failure):
        raise TypeError(marker.message)
    return photo, marker


def print_squares(boards: Sequence[tuple[str, Path, str]]) -> None:
    print(
        f"{'':<14} {'':<10}" + "".join(f"{name:>9}" for name in NAMES) + f"{'mean':>7}{'worst':>7}"
    )
    for name, folder, side in boards:
        photo, marker = read_board(folder, side)
        correction = measure_colour(photo, marker)
        rows = {
            "as taken": differences(photo.pixels_bgr, folder, side),
            "white": differences(
                apply_colour(photo.pixels_bgr, white_alone(photo, marker)), folder, side
            ),
            correction.kind: differences(apply_colour(photo.pixels_bgr, correction), folder, side),
            "left out": left_out(photo, marker, folder, side),
        }
        for row, values in rows.items():
            figures = "".join(f"{value:9.1f}" for value in values)
            print(f"{name:<14} {row:<10}{figures}{values.mean():7.2f}{values.max():7.2f}")
        print(f"{name:<14} flags: {', '.join(correction.flags) or 'none'}")


def white_alone(photo: Photo, marker: MarkerObservation) -> ColourCorrection:
    white = find_white(sample_board(photo.pixels_bgr, marker))
    return ColourCorrection(np.diag(PAPER_WHITE / white.linear), "white")


def left_out(photo: Photo, marker: MarkerObservation, folder: Path, side: str) -> Any:
    """(10,) difference of each square after a fit that did not see it."""
    samples = sample_board(photo.pixels_bgr, marker)
    out = []
    for index, (row, column) in enumerate(COLOUR_SQUARES):
        is_clipped = samples.is_clipped.copy()
        is_clipped[row + 1, column + 1] = True  # as one that is of no use
        fit = fit_matrix(
            replace(samples, is_clipped=is_clipped), find_white(samples), COLOUR_SQUARES
        )
        corrected = apply_colour(photo.pixels_bgr, ColourCorrection(fit.matrix, "colour"))
        out.append(differences(corrected, folder, side)[index])
    return np.array(out)


def differences(pixels_bgr: Any, folder: Path, side: str) -> Any:
    """(10,) CIEDE2000 of the squares in a picture from their printed colours."""
    seen = seen_squares(pixels_bgr, json.loads((folder / "truth.json").read_text()), side)
    return ciede2000(lab_of(seen), lab_of(reference_linear(COLOUR_SQUARES)))


def seen_squares(pixels_bgr: Any, truth: dict[str, Any], side: str) -> Any:
    """(10, 3) linear, mean over two thirds of each coloured square, by the scene's true poses."""
    camera, marker, pose = truth["camera"], truth["marker"], truth["poses_world_to_camera"][side]
    intrinsics = np.array([[pose["f"], 0, pose["cx"]], [0, pose["f"], pose["cy"]], [0, 0, 1.0]])
    cosine, sine = np.cos(marker["yaw"]), np.sin(marker["yaw"])
    across = np.linspace(-1 / 3, 1 / 3, 25)
    offsets = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    out = []
    for row, column in COLOUR_SQUARES:
        middle = np.array([column + 0.5 - marker["cols"] / 2, marker["rows"] / 2 - row - 0.5])
        sheet = (
            (middle + offsets) * marker["square_mm"] @ np.array([[cosine, sine], [-sine, cosine]])
        )
        table = np.column_stack([sheet + marker["centre"], np.full(len(sheet), SHEET_MM)])
        rotation, shift = cv2.Rodrigues(np.array(pose["R"]))[0], np.array(pose["t_mm"])
        seen = cv2.projectPoints(
            table, rotation, shift, intrinsics, np.array(camera["distortion"])
        )[0]
        x, y = np.rint(seen.reshape(-1, 2)).astype(int).T
        out.append(linear_rgb(pixels_bgr[y, x]).mean(axis=0))
    return np.array(out)


def print_shadows(boards: Sequence[tuple[str, Path, str]]) -> None:
    print(f"\n{'shadow':<12} {'':<14} {'kind':<8} {'mean':>6}{'worst':>7} {'exposure':>9}  flags")
    for shadow, share in SHADOWS.items():
        for name, folder, side in boards[::2]:
            photo, marker = read_board(folder, side)
            lit = measure_colour(photo, marker)
            found = measure_colour(shaded(photo, marker, share), marker)
            values = differences(apply_colour(photo.pixels_bgr, found), folder, side)
            exposure = float(found.matrix[1].sum() / lit.matrix[1].sum())
            print(
                f"{shadow:<12} {name:<14} {found.kind:<8} {values.mean():6.2f}{values.max():7.2f} {exposure:9.2f}  "
                f"{', '.join(found.flags)}"
            )


def shaded(photo: Photo, marker: MarkerObservation, share: Callable[[Any, Any], Any]) -> Photo:
    """The photograph with a shadow over the board and what lies around it, in linear light."""
    spec = marker.spec
    to_photo = grid_homography(marker.corners_px.reshape(spec.rows - 1, spec.columns - 1, 2))[0]
    reach = 4 * float(np.linalg.norm(marker.corners_px[1] - marker.corners_px[0]))
    height, width = photo.pixels_bgr.shape[:2]
    left, top = np.maximum(marker.corners_px.min(axis=0) - reach, 0).astype(int)
    right, bottom = np.minimum(marker.corners_px.max(axis=0) + reach, [width, height]).astype(int)
    y, x = np.mgrid[top:bottom, left:right]
    at = (
        map_points(np.linalg.inv(to_photo), np.stack([x.ravel(), y.ravel()], -1).astype(float))
        + 1.0
    )
    dark = np.asarray(share(*at.T), np.float64).reshape(y.shape)[..., None]
    pixels = photo.pixels_bgr.copy()
    linear = LINEAR_OF_BYTE[pixels[top:bottom, left:right]] * (1.0 - dark + SHADOW * dark)
    pixels[top:bottom, left:right] = np.rint(255.0 * encode_srgb(linear)).astype(np.uint8)
    return Photo(pixels)


if __name__ == "__main__":
    sys.exit(main())
