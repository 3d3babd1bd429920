"""Rendered meals of the shared data as the pipeline takes them, and what phones and people do to such photographs."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.vision.intrinsics import Camera, camera_from_mapping
from app.vision.marker_spec import MarkerSpec, parse_marker
from app.vision.model import EstimateOptions, ImageArray, MaskArray, PhotoPair
from app.vision.photograph.photo import read_photo
from app.vision.pipeline import estimate_meal

Change = Callable[[ImageArray], Any]


@dataclass(frozen=True)
class Scene:
    """truth: of truth.json. foods: (H, W) in the left photograph."""

    pair: PhotoPair
    spec: MarkerSpec
    camera: Camera
    truth: dict[str, Any]
    foods: MaskArray

    def estimate(self, pair=None, spec=None, camera=None):
        """The default method, with the scene's own photographs, marker and true camera unless others are given."""
        return estimate_meal(pair or self.pair, EstimateOptions(spec or self.spec, camera or self.camera))

    def estimate_by_exif(self, pair):
        return estimate_meal(pair, EstimateOptions(self.spec))


def load_scene(shared_data: Path, name: str) -> Scene:
    folder = next((shared_data / "scenes" / "dev").glob(f"*/{name}"))
    truth = json.loads((folder / "truth.json").read_text())
    m, c = truth["marker"], truth["camera"]
    keys = {key: c[key] for key in ("width", "height", "cx", "cy", "distortion")}
    photos = [read_photo((folder / f"{side}.jpg").read_bytes(), max_pixels=10**8) for side in ("left", "right")]
    labels = cv2.imread(str(folder / "left_items.png"), cv2.IMREAD_GRAYSCALE)
    return Scene(
        pair=PhotoPair(*photos),
        spec=parse_marker(f"{m['kind']}:{m['cols']}x{m['rows']}:{m['square_mm']:g}"),
        camera=camera_from_mapping(keys | {"fx": c["f"], "fy": c["f"]}),
        truth=truth,
        foods=labels > 0,
    )


def changed(photo, change: Change):
    return replace(photo, pixels_bgr=np.ascontiguousarray(change(photo.pixels_bgr)))


def both(pair: PhotoPair, change: Change) -> PhotoPair:
    return PhotoPair(changed(pair.left, change), changed(pair.right, change))


def right_only(pair: PhotoPair, change: Change) -> PhotoPair:
    return PhotoPair(pair.left, changed(pair.right, change))


def as_jpeg(quality: int) -> Change:
    def change(pixels):
        return cv2.imdecode(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)

    return change


def scaled(factor: float) -> Change:
    return lambda pixels: cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def lit(blue: float, green: float, red: float) -> Change:
    """Another brightness or white balance."""
    return lambda pixels: np.clip(pixels * np.array([blue, green, red]), 0, 255).astype(np.uint8)


def rolled(scene: Scene, degrees: float) -> tuple[PhotoPair, Camera]:
    """Both photographs turned about the principal point, on a canvas that holds them whole; and their camera."""
    camera, angle = scene.camera, np.radians(degrees)
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    width = int(np.ceil(camera.width * cosine + camera.height * sine))
    height = int(np.ceil(camera.height * cosine + camera.width * sine))
    middle = ((width - 1) / 2, (height - 1) / 2)
    turn = cv2.getRotationMatrix2D((camera.cx, camera.cy), degrees, 1.0)
    turn[:, 2] += [middle[0] - camera.cx, middle[1] - camera.cy]
    pair = both(scene.pair, lambda pixels: cv2.warpAffine(pixels, turn, (width, height), flags=cv2.INTER_CUBIC))
    return pair, replace(camera, width=width, height=height, cx=middle[0], cy=middle[1])


def zoomed(pair: PhotoPair, factor: float) -> PhotoPair:
    """The right photograph enlarged about its middle, as digital zoom does, which its EXIF tells."""
    height, width = pair.right.pixels_bgr.shape[:2]
    size = (round(height / factor), round(width / factor))
    top, left = (height - size[0]) // 2, (width - size[1]) // 2
    part = pair.right.pixels_bgr[top : top + size[0], left : left + size[1]]
    pixels = cv2.resize(part, (width, height), interpolation=cv2.INTER_CUBIC)
    return PhotoPair(pair.left, replace(pair.right, pixels_bgr=pixels, focal_35mm=pair.right.focal_35mm * factor))


def with_marker_moved(scene: Scene, x_mm: float, y_mm: float, turn: float = 0.0) -> PhotoPair:
    """The sheet pushed over the table, and turned by radians, before the right photograph was taken."""
    marker, to_photo = scene.truth["marker"], _plane_to_photo(scene, "right", 0.0)
    half = (np.array([marker["cols"], marker["rows"]]) / 2 + 1.15) * marker["square_mm"]
    sheet = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ _turn(marker["yaw"]).T + marker["centre"]
    corners = cv2.perspectiveTransform(sheet[None], to_photo)[0]
    mask = np.zeros(scene.foods.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 255)
    move = np.eye(3)
    move[:2, :2] = _turn(turn)
    move[:2, 2] = np.array([x_mm, y_mm]) + marker["centre"] - move[:2, :2] @ marker["centre"]
    return right_only(scene.pair, lambda pixels: _pasted(pixels, mask, to_photo @ move @ np.linalg.inv(to_photo)))


def with_food_moved(scene: Scene, x_mm: float, y_mm: float) -> PhotoPair:
    """The foods pushed, without what they rest on, after the left photograph was taken."""
    to_photo = _plane_to_photo(scene, "left", 15.0)
    move = np.array([[1.0, 0.0, x_mm], [0.0, 1.0, y_mm], [0.0, 0.0, 1.0]])
    mask = cv2.dilate(scene.foods.astype(np.uint8) * 255, np.ones((25, 25), np.uint8))
    moved = changed(scene.pair.left, lambda pixels: _pasted(pixels, mask, to_photo @ move @ np.linalg.inv(to_photo)))
    return PhotoPair(moved, scene.pair.right)


def _plane_to_photo(scene: Scene, side: str, height_mm: float):
    """(3, 3) homography of the plane at this height over the table, mm, to the photograph, px."""
    pose = scene.truth["poses_world_to_camera"][side]
    rotation = np.array(pose["R"])
    plane = np.column_stack([rotation[:, :2], rotation[:, 2] * height_mm + np.ravel(pose["t_mm"])])
    return scene.camera.matrix @ plane


def _turn(angle: float):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _pasted(pixels, mask, move):
    """What the mask covers, moved; its old place filled with its surroundings' colours."""
    height, width = mask.shape
    small = cv2.resize(pixels, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    hole = cv2.dilate(cv2.resize(mask, small.shape[1::-1]), np.ones((5, 5), np.uint8))
    filled = cv2.resize(cv2.inpaint(small, hole, 5, cv2.INPAINT_TELEA), (width, height))
    emptied = np.where(cv2.dilate(mask, np.ones((9, 9), np.uint8))[..., None] > 0, filled, pixels)
    moved = cv2.warpPerspective(pixels, move, (width, height), flags=cv2.INTER_CUBIC)
    return np.where(cv2.warpPerspective(mask, move, (width, height))[..., None] > 127, moved, emptied)
