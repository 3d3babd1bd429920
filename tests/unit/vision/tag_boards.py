"""Synthetic photographs of OpenCV's own ArUco and ChArUco boards, seen by a known camera from a known place."""

import cv2
import numpy as np

from app.vision.board.print_layout import print_points_mm
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float64Array, ImageArray, Photo
from tests.unit.vision.synthetic import BLACK, PHONE, TABLE, WHITE, project

PX_PER_MM = 10
OVERSAMPLING = 3


def cv2_board(spec: MarkerSpec, *, is_legacy: bool = False) -> cv2.aruco.Board:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(spec.dictionary)))
    size = (spec.columns, spec.rows)
    if spec.kind == "aruco":
        return cv2.aruco.GridBoard(size, spec.square_mm, spec.gap_mm, dictionary)
    board = cv2.aruco.CharucoBoard(size, spec.square_mm, spec.tag_mm, dictionary)
    board.setLegacyPattern(is_legacy)
    return board


def sheet_picture(spec: MarkerSpec, *, is_legacy: bool = False) -> ImageArray:
    """The sheet as OpenCV draws it, with its margin, PX_PER_MM."""
    size = (round(spec.width_mm * PX_PER_MM), round(spec.height_mm * PX_PER_MM))
    picture = cv2_board(spec, is_legacy=is_legacy).generateImage(size, marginSize=0)
    margin = round(spec.margin_mm * PX_PER_MM)
    return np.asarray(cv2.copyMakeBorder(picture, *[margin] * 4, cv2.BORDER_CONSTANT, value=255), np.uint8)


def photograph(
    spec, pose, *, camera=PHONE, picture: ImageArray | None = None, covers_mm=(), light=(1.0, 1.0, 1.0), noise=1.5
) -> Photo:
    """picture: the sheet, PX_PER_MM; None: OpenCV's. covers_mm: x, y, width, height of paper that hides the print, in
    the table frame. light: factors on blue, green and red. Lens distortion is left out.
    """
    sheet = sheet_picture(spec) if picture is None else picture
    reflectance = np.where(sheet > 127, WHITE, BLACK).astype(np.float32)
    middle = (np.array(sheet.shape[::-1]) - 1) / 2
    for x, y, width, height in covers_mm:
        left, top = np.rint(middle + np.array([x, -y - height]) * PX_PER_MM).astype(int)
        right, bottom = left + round(width * PX_PER_MM), top + round(height * PX_PER_MM)
        reflectance[max(top, 0) : bottom, max(left, 0) : right] = TABLE
    corners = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) * 50.0
    seen = project(camera, pose, np.column_stack([corners, np.zeros(4)]))
    fine = (seen + 0.5) * OVERSAMPLING - 0.5
    in_picture = middle + corners * [PX_PER_MM, -PX_PER_MM]
    homography = cv2.getPerspectiveTransform(in_picture.astype(np.float32), fine.astype(np.float32))
    size = (camera.width * OVERSAMPLING, camera.height * OVERSAMPLING)
    border = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": TABLE}
    warped = cv2.warpPerspective(cv2.GaussianBlur(reflectance, (0, 0), 1.5), homography, size, **border)
    warped = cv2.resize(warped, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(warped, (0, 0), 0.6)
    linear = grey[..., None] * np.asarray(light)
    levels = 255.0 * np.clip(linear, 0.0, 1.0) ** (1 / 2.2)
    levels = levels + np.random.default_rng(0).normal(0.0, noise, levels.shape)
    return Photo(np.clip(levels + 0.5, 0, 255).astype(np.uint8))


def points_table(spec: MarkerSpec) -> Float64Array:
    """(n, 3) the print's points, mm."""
    points = print_points_mm(spec)
    return np.column_stack([points, np.zeros(len(points))])
