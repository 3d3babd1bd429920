"""Photographs of printed boards with known colours, made in linear light."""

import numpy as np

from app.vision.board.colour_space import LINEAR_OF_BYTE, encode_srgb, linear_rgb
from app.vision.marker_spec import COLOUR_SQUARES, ColourBoard, PlainBoard
from app.vision.model import MarkerObservation, Photo

COLOUR, PLAIN = ColourBoard(4, 5, 12.0), PlainBoard(9, 7, 11.0)
SQUARE_PX = 24
PAPER, INK = 0.84, 0.04


def places(spec, square_px=SQUARE_PX):
    """(H, W, 2) across and down in squares from the board's top left corner, the margin of one square and a half."""
    size = [round((side + 3) * square_px) for side in (spec.columns, spec.rows)]
    x, y = np.meshgrid(*(np.arange(side) for side in size))
    return np.stack([x, y], -1) / square_px - 1.5


def reflectance(spec, at, paper=PAPER):
    """(H, W, 3) linear, red first; beside the sheet a dark table."""
    column, row = np.floor(np.moveaxis(at, -1, 0)).astype(int)
    out = np.full((*column.shape, 3), paper)
    for r in range(spec.rows):
        for c in range(spec.columns):
            if spec.kind == "colour" and (r, c) in COLOUR_SQUARES:
                out[(row == r) & (column == c)] = LINEAR_OF_BYTE[list(COLOUR_SQUARES[r, c])]
            elif spec.kind == "plain" and (r + c) % 2 == 0:
                out[(row == r) & (column == c)] = INK
    return out


def board_photo(spec, camera=None, light=1.0, paper=PAPER, noise=0.0, square_px=SQUARE_PX):
    """A photograph and its marker. camera: (3, 3) in linear light, or gains; light: number or (H, W[, 3]) factors."""
    at = places(spec, square_px)
    linear = reflectance(spec, at, paper) * (light[..., None] if np.ndim(light) == 2 else light)
    camera = np.eye(3) if camera is None else np.diag(camera) if np.ndim(camera) == 1 else camera
    linear = linear @ np.asarray(camera).T
    linear = linear + np.random.default_rng(0).normal(0.0, 1.0, linear.shape) * noise
    pixels = np.rint(255.0 * encode_srgb(linear)).astype(np.uint8)[..., ::-1]
    inner = np.meshgrid(np.arange(1, spec.columns), np.arange(1, spec.rows))
    corners = (np.stack(inner, -1).reshape(-1, 2) + 1.5) * square_px - 0.5
    return Photo(np.ascontiguousarray(pixels)), MarkerObservation(spec, corners.astype(np.float64))


def printed_colours(pixels_bgr, square_px=SQUARE_PX):
    """(10, 3) linear, red first, mean over the inner half of each coloured square."""
    reach = square_px // 4
    out = []
    for row, column in COLOUR_SQUARES:
        y, x = (row + 2) * square_px, (column + 2) * square_px
        out.append(linear_rgb(pixels_bgr[y - reach : y + reach, x - reach : x + reach]).mean(axis=(0, 1)))
    return np.array(out)
