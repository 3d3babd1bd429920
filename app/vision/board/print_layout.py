"""Where a print's points and tags lie, and which part of the print a photograph shows.

MarkerSpec or MarkerObservation in -> points, corners of tags, rectangles of the print, mm in the table frame; points
that two observations share; tags and their size in px.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from app.vision.board.grid import shortest_step_px
from app.vision.geometry.projective import map_points
from app.vision.marker_spec import MarkerSpec, TagBoard
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
    shared, at_first, at_second = np.intersect1d(
        first.point_ids, second.point_ids, return_indices=True
    )
    return CommonPoints(first.corners_px[at_first], second.corners_px[at_second], shared)


def print_points_mm(spec: MarkerSpec) -> Float64Array:
    """(n, 2) x, y of the print's points in the table frame (CONVENTIONS.md, "Marker").

    Inner corners, row-major; of an ArUco board the corners of its tags, tag by tag.
    """
    if isinstance(spec, TagBoard) and spec.points_are_tags:
        return tag_corners_mm(spec).reshape(-1, 2)
    rows, columns = np.indices((spec.rows - 1, spec.columns - 1)).reshape(2, -1)
    x = (columns + 1 - spec.columns / 2) * spec.square_mm
    y = (spec.rows / 2 - rows - 1) * spec.square_mm
    return np.stack([x, y], axis=1)


def tag_corners_mm(spec: TagBoard, *, is_legacy: bool = False) -> Float64Array:
    """(tags, 4, 2) x, y of each tag's corners in the table frame, clockwise on the print from the upper left.

    is_legacy: as OpenCV before 4.6 placed them.
    """
    places = spec.legacy_tag_places() if is_legacy else spec.tag_places()
    rows, columns = np.array(places).T
    x = columns * spec.pitch_mm + (spec.square_mm - spec.width_mm) / 2
    y = (spec.height_mm - spec.square_mm) / 2 - rows * spec.pitch_mm
    middle = np.stack([x, y], axis=1)
    return middle[:, None] + TAG_CORNERS * spec.tag_mm


def seen_squares(marker: MarkerObservation) -> MaskArray:
    """(rows, columns) squares all of whose points are observed: of ArUco its tags."""
    spec = marker.spec
    if marker.point_ids is None:
        return np.ones((spec.rows, spec.columns), np.bool_)
    if spec.points_are_tags:
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
            above = next(
                (block for block in blocks if block[1:] == (row - 1, start, end - 1)), None
            )
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
        low_y=spec.height_mm / 2
        - bottom * spec.pitch_mm
        - spec.square_mm
        - beyond(bottom == spec.rows - 1),
        high_x=right * spec.pitch_mm
        + spec.square_mm
        - spec.width_mm / 2
        + beyond(right == spec.columns - 1),
        high_y=spec.height_mm / 2 - top * spec.pitch_mm + beyond(top == 0),
    )


def border_share(spec: TagBoard) -> float:
    """The narrower of a tag's black border, which is one cell wide, and the white around it, of the tag's side."""
    white_mm = spec.gap_mm + (spec.square_mm - spec.tag_mm) / 2
    return min(1.0 / spec.cells, white_mm / spec.tag_mm)


def shortest_side_px(marker: MarkerObservation) -> float:
    """The shortest side of the marker's squares (of ArUco its tags) in the photograph, px."""
    spec = marker.spec
    if marker.point_ids is None:
        return shortest_step_px(marker.grid_px)
    if spec.points_are_tags:
        quads = marker.corners_px.reshape(-1, 4, 2)
        return float(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=-1).min())
    flat = np.full(((spec.rows - 1) * (spec.columns - 1), 2), np.nan)
    flat[marker.point_ids] = marker.corners_px
    grid = flat.reshape(spec.rows - 1, spec.columns - 1, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    return float(np.nanmin(np.concatenate(steps)))


def seen_tags_px(marker: MarkerObservation, spec: TagBoard) -> tuple[Int64Array, Float64Array]:
    """(n,) numbers of the tags in view and (n, 4, 2) their corners, px: of ChArUco by the squares around them."""
    rows, columns = np.array(spec.tag_places()).T
    ids = np.flatnonzero(seen_squares(marker)[rows, columns])
    if spec.points_are_tags:
        return ids, marker.corners_px.reshape(-1, 4, 2)
    seen_mm = marker.seen_of(print_points_mm(spec))
    homography = np.asarray(cv2.findHomography(seen_mm, marker.corners_px)[0], np.float64)
    return ids, map_points(homography, tag_corners_mm(spec)[ids].reshape(-1, 2)).reshape(-1, 4, 2)
