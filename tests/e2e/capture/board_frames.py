"""Preview frames of printed boards with known geometry, as the capture page's live help gets them."""

from functools import cache

import cv2
import numpy as np

from app.vision.board.tag_bits import black_cells
from app.vision.marker_spec import COLOUR_SQUARES, parse_marker

FOCAL_SHARE = 0.8  # of the long side, as view_angle.js assumes
TEXELS_PER_MM = 8
SIZE = (640, 480)


@cache
def printed(spec):
    """(h, w) grey print with its margin, TEXELS_PER_MM; for the colour board the smallest channel."""
    k = TEXELS_PER_MM
    sheet = np.full(
        (round((spec.height_mm + 2 * spec.margin_mm) * k), round((spec.width_mm + 2 * spec.margin_mm) * k)), 235
    )

    def fill(x, y, side, level):
        left, top = round((spec.margin_mm + x) * k), round((spec.margin_mm + y) * k)
        sheet[top : top + round(side * k), left : left + round(side * k)] = level

    def tag(number, x, y):
        black = black_cells(str(spec.dictionary), number)
        cell = spec.tag_mm / len(black)
        for row, column in np.argwhere(black):
            fill(x + column * cell, y + row * cell, cell, 30)

    number = 0
    for row in range(spec.rows):
        for column in range(spec.columns):
            x, y = column * spec.pitch_mm, row * spec.pitch_mm
            if spec.kind == "aruco":
                tag(number, x, y)
                number += 1
            elif spec.kind == "colour":
                fill(x, y, spec.square_mm, round(0.92 * min(COLOUR_SQUARES.get((row, column), (255,)))))
            elif (row + column) % 2 == 0:
                fill(x, y, spec.square_mm, 30)
            elif spec.kind == "charuco":
                inset = (spec.square_mm - spec.tag_mm) / 2
                tag(number, x + inset, y + inset)
                number += 1
    return sheet.astype(np.uint8)


def camera_matrix(size=SIZE):
    """A pinhole of FOCAL_SHARE, principal point in the middle of pixels 0 to width - 1."""
    focal = FOCAL_SHARE * max(size)
    return np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])


def look_at(azimuth_deg, tilt_deg, distance_mm, roll_deg=0.0):
    """Rotation and shift, board (x right, y down, z into the table, origin in its middle) to camera.

    azimuth_deg: from the reader's side of the board towards its right side. tilt_deg: from straight above.
    """
    azimuth, tilt = np.radians([azimuth_deg, tilt_deg])
    centre = distance_mm * np.array([np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), -np.cos(tilt)])
    forward = -centre / distance_mm
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    down = np.cross(forward, right)
    roll = np.radians(roll_deg)
    right, down = np.cos(roll) * right + np.sin(roll) * down, -np.sin(roll) * right + np.cos(roll) * down
    rotation = np.stack([right, down, forward])
    return rotation, -rotation @ centre


def frame_of(marker, pose, size=SIZE, table=110, blur_px=0.6, noise=2.0, seed=1):
    """Grey frame (h, w) uint8 and the true corners (4, 2) px of the squares' area, from the upper left clockwise."""
    spec = parse_marker(marker)
    rotation, shift = pose
    to_px = camera_matrix(size) @ np.column_stack([rotation[:, 0], rotation[:, 1], shift])  # mm from the middle -> px
    sheet = printed(spec)
    height, width = sheet.shape
    k = TEXELS_PER_MM
    to_mm = np.array([[1 / k, 0, (0.5 - width / 2) / k], [0, 1 / k, (0.5 - height / 2) / k], [0, 0, 1]])
    fine = 4  # samples a pixel along each side
    to_fine = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1]])
    large = (size[0] * fine, size[1] * fine)
    sheet = cv2.GaussianBlur(sheet, (0, 0), 1.5)
    picture = cv2.warpPerspective(
        sheet, to_fine @ to_px @ to_mm, large, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=table
    )
    picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    picture = cv2.GaussianBlur(picture, (0, 0), blur_px)
    picture += np.random.default_rng(seed).normal(0, noise, picture.shape)
    half = np.array([spec.width_mm, spec.height_mm]) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    pixels = cv2.perspectiveTransform(corners[None].astype(np.float64), to_px)[0]
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), pixels
