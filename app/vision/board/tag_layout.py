"""Where the tags of an ArUco or ChArUco board lie on the print, and which part of a print a photograph shows.

MarkerSpec or MarkerObservation in -> corners of tags, rectangles of the print, mm in the table frame; points that two
observations share.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float64Array, Int64Array, MarkerObservation, MaskArray

# A tag's corners from its middle, in sides, y up: clockwise on the print from the upper left, as OpenCV lists them.
TAG_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


class PrintRectangle(NamedTuple):
    """Part of a print in the table frame, mm."""

    low_x: float
    low_y: float
    high_x: float
    high_y: float


@dataclass(frozen=True, slots=True)
class CommonPoints:
    """The print's points that both observations have: (n, 2) px in each; point_ids as in MarkerObservation."""

    first_px: Float64Array
    second_px: Float64Array
    point_ids: Int64Array | None

    def of(self, points: Float64Array) -> Float64Array:
        """Those of (m, ...), one row per point of the print."""
        return points if self.point_ids is None else points[self.point_ids]


def common_points(first: MarkerObservation, second: MarkerObservation) -> CommonPoints:
    """The points that both observations of one print have."""
    if first.point_ids is None or second.point_ids is None:
        return CommonPoints(first.corners_px, second.corners_px, None)
    shared, at_first, at_second = np.intersect1d(first.point_ids, second.point_ids, return_indices=True)
    return CommonPoints(first.corners_px[at_first], second.corners_px[at_second], shared)


def tag_places(spec: MarkerSpec, *, is_legacy: bool = False) -> Int64Array:
    """(tags, 2) row and column of each tag, by its number.

    On a ChArUco board the upper left square is dark and tags lie in the light ones. is_legacy: as OpenCV before 4.6
    printed boards with an even number of rows, the other way round.
    """
    rows, columns = np.indices((spec.rows, spec.columns)).reshape(2, -1)
    if spec.kind == "charuco":
        has_tag = (rows + columns) % 2 == (0 if is_legacy and spec.rows % 2 == 0 else 1)
        rows, columns = rows[has_tag], columns[has_tag]
    return np.stack([rows, columns], axis=1).astype(np.int64)


def tag_corners_mm(spec: MarkerSpec, *, is_legacy: bool = False) -> Float64Array:
    """(tags, 4, 2) x, y of each tag's corners in the table frame, clockwise on the print from the upper left."""
    rows, columns = tag_places(spec, is_legacy=is_legacy).T
    x = columns * spec.pitch_mm + (spec.square_mm - spec.width_mm) / 2
    y = (spec.height_mm - spec.square_mm) / 2 - rows * spec.pitch_mm
    middle = np.stack([x, y], axis=1)
    return np.asarray(middle[:, None] + TAG_CORNERS * spec.tag_mm, np.float64)


def seen_squares(marker: MarkerObservation) -> MaskArray:
    """(rows, columns) squares all of whose points are observed: of ArUco its tags."""
    spec = marker.spec
    if marker.point_ids is None:
        return np.ones((spec.rows, spec.columns), np.bool_)
    if spec.kind == "aruco":
        is_seen = np.zeros(4 * spec.rows * spec.columns, np.bool_)
        is_seen[marker.point_ids] = True
        return np.asarray(is_seen.reshape(spec.rows, spec.columns, 4).all(axis=2))
    inner = np.zeros((spec.rows - 1) * (spec.columns - 1), np.bool_)
    inner[marker.point_ids] = True
    corners = np.pad(inner.reshape(spec.rows - 1, spec.columns - 1), 1, constant_values=True)
    return np.asarray(corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:])


def sheet_half_mm(spec: MarkerSpec) -> tuple[float, float]:
    """Half the printed sheet's width and height, margin included, mm."""
    return spec.width_mm / 2 + spec.margin_mm, spec.height_mm / 2 + spec.margin_mm


def seen_print_mm(marker: MarkerObservation) -> list[PrintRectangle]:
    """What is seen of the print, margin included, as few rectangles; of a checkerboard the whole sheet.

    Food may stand on a board of tags, or the tags may be a frame around it: what hides a tag, and what lies where no
    tag is printed, is not the print.
    """
    spec, is_seen = marker.spec, seen_squares(marker)
    if is_seen.all():
        half_x, half_y = sheet_half_mm(spec)
        return [PrintRectangle(-half_x, -half_y, half_x, half_y)]
    blocks: list[tuple[int, int, int, int]] = []  # first row, last row, first column, last column
    for row in range(spec.rows):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_seen[row].view(np.int8), [0]])))
        for start, end in edges.reshape(-1, 2).tolist():
            above = next((block for block in blocks if block[1:] == (row - 1, start, end - 1)), None)
            if above is not None:
                blocks.remove(above)
            blocks.append((above[0] if above is not None else row, row, start, end - 1))
    return [_rectangle(spec, *block) for block in blocks]


def _rectangle(spec: MarkerSpec, top: int, bottom: int, left: int, right: int) -> PrintRectangle:
    """Of squares from one row and column to another, with the margin, or half of the gap where the print goes on."""

    def beyond(is_edge: bool) -> float:
        return spec.margin_mm if is_edge else spec.gap_mm / 2

    return PrintRectangle(
        low_x=left * spec.pitch_mm - spec.width_mm / 2 - beyond(left == 0),
        low_y=spec.height_mm / 2 - bottom * spec.pitch_mm - spec.square_mm - beyond(bottom == spec.rows - 1),
        high_x=right * spec.pitch_mm + spec.square_mm - spec.width_mm / 2 + beyond(right == spec.columns - 1),
        high_y=spec.height_mm / 2 - top * spec.pitch_mm + beyond(top == 0),
    )
