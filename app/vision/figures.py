"""A picture of each step, like the paper's Figure 6, the point cloud and the scene: what a run shows of itself.

Trace in -> JPEG, PLY and JSON files as bytes, in the colours that the marker corrects. Steps that the run did not
reach have no picture.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.vision.board.colour_correction import apply_colour
from app.vision.model import (
    Artefact,
    ColourCorrection,
    Float32Array,
    Float64Array,
    ImageArray,
    ItemEstimate,
    MaskArray,
    Photo,
    PhotoPair,
    View,
)
from app.vision.scene_file import SCENE_NAME, write_scene
from app.vision.solids.measured_item import MeasuredItem, Volume
from app.vision.trace import Trace
from app.vision.views.features import Matches
from app.vision.views.reconstruction import Reconstruction
from app.vision.views.relative_pose import RefinedViews

WIDTH_PX = 1600
JPEG_QUALITY = 88
SHOWN_MATCHES = 60  # beside the sixteen; more hide the photograph
CLOUD_POINTS = 150_000
CLOUD_VIEW_PX = 900
SHOWN_ITEMS = 3  # side by side
ROW_LINES = 12  # drawn across a rectified pair
WHITE, BLACK, RED, GREEN, GREY = (
    (255, 255, 255),
    (0, 0, 0),
    (40, 40, 220),
    (60, 190, 60),
    (170, 170, 170),
)
PLY_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
ITEM_COLOURS = ((40, 40, 220), (60, 170, 40), (220, 120, 30), (30, 160, 230), (190, 50, 170))


def draw_artefacts(
    trace: Trace, pair: PhotoPair, items: tuple[ItemEstimate, ...]
) -> list[Artefact]:
    """Files by step: matches, rectified, disparity, points (and PLY), slices, overlay, scene."""
    scene = trace.scene
    pictures: dict[str, ImageArray | None] = {}
    if trace.refined is not None and trace.matches is not None and trace.is_good_match is not None:
        pictures["matches.jpg"] = _matches(trace, trace.refined, trace.matches, trace.is_good_match)
    if scene is not None:
        first = apply_colour(scene.rectified.first_bgr, trace.colour_of(0))
        disparity = scene.rectified.disparity_from_parallax(scene.disparity.parallax_px)
        if scene.rectified.second_bgr is not None:
            # The pair that depth is measured on; the second is sheared so that the marker's plane coincides.
            second = apply_colour(scene.rectified.second_bgr, trace.colour_of(1))
            pictures["rectified.jpg"] = _with_rows(_side_by_side(first, second))
        pictures["disparity.jpg"] = _side_by_side(first, _coloured(disparity))
        measured = [(item, item.volume) for item in trace.items if item.volume is not None][
            :SHOWN_ITEMS
        ]
        if measured:
            pictures["points.jpg"] = _point_cloud(measured, scene, first)
            pictures["slices.jpg"] = _slices([volume for _, volume in measured])
    if items and trace.colours is not None:
        pictures["overlay.jpg"] = _overlay(pair.left, trace.colours[0], items)
    out = [_jpeg(name, picture) for name, picture in pictures.items() if picture is not None]
    if scene is not None:
        is_measured = np.isfinite(scene.points_table[..., 2])
        points, colours = scene.points_table[is_measured].astype(np.float64), first[is_measured]
        step = max(1, len(points) // CLOUD_POINTS)
        out.append(Artefact("points.ply", "model/ply", write_ply(points[::step], colours[::step])))
    content = write_scene(trace, pair, items)
    return out if content is None else [*out, Artefact(SCENE_NAME, "application/json", content)]


def _jpeg(name: str, picture: ImageArray) -> Artefact:
    done, data = cv2.imencode(
        ".jpg", _shrunk(picture, WIDTH_PX)[0], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    if not done:
        raise ValueError(f"{name} cannot be encoded.")
    return Artefact(name, "image/jpeg", data.tobytes())


def _shrunk(picture: ImageArray, width_px: float) -> tuple[ImageArray, float]:
    """The picture no wider than that, and by which factor."""
    scale = min(1.0, width_px / picture.shape[1])
    return np.asarray(
        cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
    ), scale


def _reduced(view: View, colour: ColourCorrection) -> tuple[ImageArray, float]:
    small, scale = _shrunk(view.photo.pixels_bgr, WIDTH_PX / 2)
    return apply_colour(small, colour), scale


def _side_by_side(first: ImageArray, second: ImageArray) -> ImageArray:
    height = max(first.shape[0], second.shape[0])
    padded = [
        cv2.copyMakeBorder(
            image, 0, height - image.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=WHITE
        )
        for image in (first, second)
    ]
    return np.hstack(padded)


def _matches(trace: Trace, views: RefinedViews, matches: Matches, is_good: MaskArray) -> ImageArray:
    """Some of the good matches beside the board."""
    first, scale = _reduced(views.first, trace.colour_of(0))
    second, scale_second = _reduced(views.second, trace.colour_of(1))
    picture = _side_by_side(first, second)
    good = np.flatnonzero(is_good & ~matches.is_board)
    count = min(SHOWN_MATCHES, len(good))
    for index in good[np.linspace(0, len(good) - 1, count).astype(np.int64)]:
        start = matches.first_px[index] * scale
        end = matches.second_px[index] * scale_second + np.array([first.shape[1], 0])
        corners = [(round(float(x)), round(float(y))) for x, y in (start, end)]
        cv2.line(picture, corners[0], corners[1], GREEN, 1, cv2.LINE_AA)
        for corner in corners:
            cv2.circle(picture, corner, 4, RED, 1, cv2.LINE_AA)
    return picture


def _with_rows(picture: ImageArray) -> ImageArray:
    for row in np.linspace(0, picture.shape[0] - 1, ROW_LINES + 2)[1:-1].astype(int):
        cv2.line(picture, (0, int(row)), (picture.shape[1] - 1, int(row)), GREEN, 1)
    return picture


def _coloured(values: Float32Array) -> ImageArray:
    """Values from their 1st to their 99th percentile in colours; black for NaN."""
    is_measured = np.isfinite(values)
    if not is_measured.any():
        return np.zeros((*values.shape, 3), np.uint8)
    low, high = np.percentile(values[is_measured], [1, 99])
    scaled = np.clip(
        (np.nan_to_num(values, nan=low) - low) / max(high - low, 1e-6) * 255, 0, 255
    ).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(scaled, cv2.COLORMAP_TURBO), np.uint8)
    picture[~is_measured] = 0
    return picture


def _point_cloud(
    measured: Sequence[tuple[MeasuredItem, Volume]],
    scene: Reconstruction,
    corrected_bgr: ImageArray,
) -> ImageArray:
    """The foods' points, measured in their colours and completed in grey, from the camera's side at a low slant."""
    panels = []
    for item, volume in measured:
        keep = item.region.mask & np.isfinite(scene.points_table[..., 2])
        hidden = volume.completed_mm + np.array([0.0, 0.0, item.support_mm])
        points = np.concatenate([hidden, scene.points_table[keep].astype(np.float64)])
        paint = np.concatenate([np.full((len(hidden), 3), GREY, np.uint8), corrected_bgr[keep]])
        panels.append(_render(points, paint, volume, scene.rectified.first_centre_mm))
    return np.hstack(panels)


def _render(
    points: Float64Array, paint: ImageArray, volume: Volume, camera_mm: Float64Array
) -> ImageArray:
    """Orthographic picture from 60 degrees beside the camera, 20 degrees above the table."""
    centre = np.array([*volume.centre_mm, 0.0])
    away = camera_mm[:2] - centre[:2]
    azimuth, slant = np.arctan2(away[1], away[0]) + np.radians(60.0), np.radians(20.0)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array(
        [np.cos(azimuth) * np.cos(slant), np.sin(azimuth) * np.cos(slant), np.sin(slant)]
    )
    up = np.cross(towards, right)
    offsets = points - centre
    largest = max(volume.slices[-1].high_mm, *(each.half_axes_mm[0] for each in volume.slices))
    scale = 0.4 * CLOUD_VIEW_PX / largest
    x = np.rint(offsets @ right * scale + CLOUD_VIEW_PX / 2).astype(np.int64)
    y = np.rint(CLOUD_VIEW_PX * 0.7 - offsets @ up * scale).astype(np.int64)
    order = np.argsort(offsets @ towards, kind="stable")
    inside = (x >= 0) & (x < CLOUD_VIEW_PX - 1) & (y >= 0) & (y < CLOUD_VIEW_PX - 1)
    order = order[inside[order]]
    picture = np.full((CLOUD_VIEW_PX, CLOUD_VIEW_PX, 3), 255, np.uint8)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        picture[y[order] + dy, x[order] + dx] = paint[order]
    return picture


def _slices(volumes: Sequence[Volume]) -> ImageArray:
    """Every slice from above: points seen, points completed, and the fitted form, coloured by height."""
    panels = []
    side = WIDTH_PX // 2
    for volume in volumes:
        top = volume.slices[-1].high_mm
        extent = max(each.half_axes_mm[0] for each in volume.slices) * 1.2
        scale = side / (2 * extent)
        panel = np.full((side, side, 3), 255, np.uint8)
        places = np.rint((volume.completed_mm[:, :2] - volume.centre_mm) * scale + side / 2).astype(
            np.int64
        )
        inside = ((places >= 0) & (places < side)).all(axis=1)
        panel[places[inside, 1], places[inside, 0]] = GREY
        for each in volume.slices:
            centre = (each.centre_mm - volume.centre_mm) * scale + side / 2
            colour = cv2.applyColorMap(
                np.array([[each.low_mm / top * 255]], np.uint8), cv2.COLORMAP_TURBO
            )[0, 0]
            cv2.ellipse(
                panel,
                (round(float(centre[0])), round(float(centre[1]))),
                (round(each.half_axes_mm[0] * scale), round(each.half_axes_mm[1] * scale)),
                float(np.degrees(each.heading)),
                0.0,
                360.0,
                tuple(int(channel) for channel in colour),
                2 if each.source in ("fitted", "scaled") else 1,
                cv2.LINE_AA,
            )
        _write(
            panel,
            f"{len(volume.slices)} slices, {volume.form}: {volume.volume_ml:.0f} ml",
            (16, 36),
            0.9,
            BLACK,
        )
        panels.append(panel)
    return np.hstack(panels)


def _overlay(left: Photo, colour: ColourCorrection, items: tuple[ItemEstimate, ...]) -> ImageArray:
    """Outlines and volumes on the photograph sent as left."""
    small, scale = _shrunk(left.pixels_bgr, WIDTH_PX)
    picture = apply_colour(small, colour)
    for number, item in enumerate(items):
        line = ITEM_COLOURS[number % len(ITEM_COLOURS)]
        rings = [np.rint(ring * scale).astype(np.int32) for ring in item.rings]
        cv2.polylines(picture, rings, True, line, 3, cv2.LINE_AA)
        if not rings:
            continue
        words = "not measurable"
        if item.volume_ml is not None and item.volume_interval_ml is not None:
            words = f"{item.volume_ml:.0f} ml ({item.volume_interval_ml[0]:.0f} - {item.volume_interval_ml[1]:.0f})"
        x, y = rings[0].min(axis=0)
        place = (int(np.clip(x, 5, picture.shape[1] - 380)), int(max(y - 12, 30)))
        _write(picture, words, place, 0.9, line)
    return picture


def _write(
    picture: ImageArray,
    text: str,
    place: tuple[int, int],
    size: float,
    colour: tuple[int, int, int],
) -> None:
    for ink, width in ((WHITE, 6), (colour, 2)):
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, ink, width, cv2.LINE_AA)


def write_ply(points_mm: Float64Array, colours_bgr: ImageArray) -> bytes:
    """A binary PLY file of (n, 3) points in mm with (n, 3) uint8 BGR colours.

    Raises ValueError if the lengths differ.
    """
    if len(points_mm) != len(colours_bgr):
        raise ValueError(f"There are {len(points_mm)} points, but {len(colours_bgr)} colours.")
    vertices = np.zeros(len(points_mm), PLY_VERTEX)
    vertices["xyz"] = points_mm
    vertices["rgb"] = colours_bgr[:, ::-1]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment table frame, mm, z up from the marker's plane",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
        "end_header",
    ]
    return ("\n".join(header) + "\n").encode("ascii") + vertices.tobytes()
