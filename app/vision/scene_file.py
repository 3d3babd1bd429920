"""The scene in one small file, which a browser draws and people turn about: `scene.json`.

Trace -> JSON: points with their colours, each food's closed shape and slices, its outline in the right photograph, the
board to scale, the cameras. Lengths in mm in the table frame, z up (CONVENTIONS.md), heights counted as the volumes'
were. What the run did not reach or use is not in it, such as the board of a meal that a rig measured. docs/volume.md,
"The scene in 3D", describes each key.
"""

import base64
import json
from collections.abc import Sequence

import cv2
import numpy as np

from app.core.units import ml_from_mm3
from app.vision.board.colour_correction import apply_colour
from app.vision.geometry.masks import inward_px
from app.vision.geometry.mesh import IntArray, enclosed_mm3
from app.vision.geometry.topview import TableTrend
from app.vision.marker_spec import BLACK, MarkerSpec
from app.vision.model import (
    Float64Array,
    ItemEstimate,
    MarkerObservation,
    MaskArray,
    Photo,
    PhotoPair,
    View,
)
from app.vision.solids.measured_item import MeasuredItem, Volume
from app.vision.solids.outlines import (
    photograph_px,
    points_in_photograph,
    rings_of,
    rings_of_faces,
    second_grid_in_photograph,
)
from app.vision.trace import Trace
from app.vision.views.reconstruction import Reconstruction

Document = dict[str, object]  # JSON

HELD_FLAGS = frozenset({"inside_guessed", "vessel_library"})  # of what a vessel holds
SCENE_NAME = "scene.json"
SCENE_VERSION = 1
MAX_BYTES = 1_400_000  # of the file: a phone reads it too
MAX_POINTS = 40_000
POINT_BYTES = 12  # three times two of its place, three of its colour, four thirds of that as text
FOOD_SHARE = 0.5  # of the points, at most, for the foods: the table between them and the board shows where they stand
AROUND_MM = 60.0  # beside the foods and the board, of the table
AROUND_BOARD_MM = 250.0  # where no food was found
HEIGHTS_MM = (-15.0, 250.0)  # outside lie strays
LIGHT_SQUARE, DARK_SQUARE = (255, 255, 255), (20, 20, 20)  # paper and black ink, sRGB
PLASTIC = 0.7548776662466927  # 1 / p, p^3 = p + 1; Roberts (2018), "The unreasonable effectiveness of quasirandom..."
STEPS = 65_535  # of a coordinate in 16 bits


def write_scene(trace: Trace, pair: PhotoPair, items: Sequence[ItemEstimate]) -> bytes | None:
    """The file, or None where neither a marker was found nor a photograph placed over the table.

    items: the answer's: first those of trace.items, in their order, then missed hints, which nothing is drawn of.
    """
    spec = next((marker.spec for marker in trace.markers if marker is not None), None)
    if spec is None and trace.views is None:
        return None
    # a board that was seen has no place in the table frame of another source
    if trace.scale not in (None, "marker"):
        spec = None
    content: Document = {
        "version": SCENE_VERSION,
        "units": "mm",
        "photographs": {
            name: _photograph(
                photo, marker, trace.views[place] if trace.views is not None else None
            )
            for place, (name, photo, marker) in enumerate(
                zip(("left", "right"), (pair.left, pair.right), trace.markers, strict=True)
            )
            if photo is not None and (name == "left" or trace.second_place == 1)
        },
    }
    if trace.scale is not None:
        content["scale_source"] = trace.scale
    if spec is not None:
        content["board"] = _board(spec)
    scene = trace.scene
    if scene is None or trace.views is None:
        return _encoded(content)
    # else outlines would be of another photograph
    right = trace.views[1] if trace.second_place == 1 else None
    topologies: list[IntArray] = []
    foods = [
        _item(index, item, estimate, topologies)
        | (
            _right_rings(item, scene, right, is_swapped=trace.is_swapped)
            if right is not None
            else {}
        )
        for index, (item, estimate) in enumerate(
            zip(trace.items, items[: len(trace.items)], strict=True)
        )
    ]
    content |= {"items": foods, "topologies": [_packed(faces, "<u2") for faces in topologies]}
    room = (MAX_BYTES - len(_encoded(content))) // POINT_BYTES
    content["points"], ranges = _points(trace, scene, spec, min(MAX_POINTS, max(room, 0)))
    for food, (start, count) in zip(foods, ranges, strict=True):
        food["points"] = {"start": start, "count": count}
    return _encoded(content)


def _encoded(content: Document) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode("ascii")


def _photograph(photo: Photo, marker: MarkerObservation | None, view: View | None) -> Document:
    height, width = photo.pixels_bgr.shape[:2]
    out: Document = {"width": width, "height": height}
    if marker is not None:
        out["marker_corners_px"] = _rounded(marker.corners_px, 2)
    if view is not None:
        camera = view.camera
        out["camera"] = {
            "fx": round(camera.fx, 3),
            "fy": round(camera.fy, 3),
            "cx": round(camera.cx, 3),
            "cy": round(camera.cy, 3),
            "distortion": _rounded(camera.distortion, 6),
            # A point in the camera's frame is rotation @ point + translation_mm.
            "rotation": _rounded(view.rotation, 8),
            "translation_mm": _rounded(view.translation_mm, 4),
            "centre_mm": _rounded(view.centre_mm, 3),
        }
    return out


def _board(spec: MarkerSpec) -> Document:
    """The board; the table frame is its own, so its pose is the identity but for its thickness."""
    colours = [spec.square_colour(square) or LIGHT_SQUARE for square in spec.squares]
    return {
        "marker": str(spec),
        "columns": spec.columns,
        "rows": spec.rows,
        "square_mm": spec.square_mm,
        "gap_mm": spec.gap_mm,  # between an ArUco board's tags, which are its squares
        "margin_mm": spec.margin_mm,  # of the white border
        "rotation": np.eye(3).tolist(),
        "translation_mm": [0.0, 0.0, round(spec.thick_mm, 3)],
        # sRGB, row by row from the top left
        "square_colours": [list(DARK_SQUARE if colour == BLACK else colour) for colour in colours],
    }


def _item(
    index: int, item: MeasuredItem, estimate: ItemEstimate, topologies: list[IntArray]
) -> Document:
    """One food. topologies: those used so far; gains a new one."""
    interval = estimate.volume_interval_ml
    out: Document = {
        "index": index,
        "hint": estimate.hint,
        "flags": list(estimate.flags),
        "volume_ml": _number(estimate.volume_ml, 3),
        "volume_interval_ml": _rounded(interval, 3) if interval is not None else None,
        "support_mm": round(item.support_mm, 3),
    }
    if item.volume is not None:
        out |= _shape(item.volume, item.support_mm, topologies)
    return out


def _shape(volume: Volume, support_mm: float, topologies: list[IntArray]) -> Document:
    shape, vertices = volume.shape, _vertices(volume, support_mm)
    same = [number for number, faces in enumerate(topologies) if np.array_equal(faces, shape.faces)]
    if not same:
        topologies.append(shape.faces)
    packed = _quantised(vertices)
    return {
        "size_mm": _size(vertices),
        "mesh_volume_ml": round(ml_from_mm3(enclosed_mm3(_unpacked(vertices), shape.faces)), 3),
        "shape": {"vertices": packed, "topology": same[0] if same else len(topologies) - 1},
        "slices": [
            {
                "low_mm": round(each.low_mm + support_mm, 3),
                "high_mm": round(each.high_mm + support_mm, 3),
                "centre_mm": _rounded(each.centre_mm, 3),
                "half_axes_mm": _rounded(each.half_axes_mm, 3),
                "heading_rad": round(each.heading, 5),
                "source": each.source,
            }
            for each in volume.slices
        ],
    }


def _size(vertices: Float64Array) -> dict[str, float]:
    """Of the smallest upright box about the shape: width is the longer side on the table, depth the shorter."""
    sides = cv2.minAreaRect(np.ascontiguousarray(vertices[:, :2], np.float32))[1]
    return {
        "width": round(max(sides), 2),
        "depth": round(min(sides), 2),
        "height": round(float(np.ptp(vertices[:, 2])), 2),
    }


def _vertices(volume: Volume, support_mm: float) -> Float64Array:
    vertices: Float64Array = volume.shape.vertices_mm + np.array([0.0, 0.0, support_mm])
    return vertices


def _right_rings(
    item: MeasuredItem, scene: Reconstruction, right: View, *, is_swapped: bool
) -> Document:
    """The food's outline in the photograph sent as right, and what it is of.

    "mask": as it was found, where that photograph is the grid's own, or no shape is known or to be seen: then the mask
    is carried over by its points. "shape": of the closed shape, as if nothing stood before it.
    """
    source = "mask"
    # Of a bowl or mug, whose wall hides all of the shape but its top.
    is_inside = not HELD_FLAGS.isdisjoint(item.flags)
    if item.volume is not None and not is_swapped and not is_inside:
        source = "shape"
        vertices = _vertices(item.volume, item.support_mm)
        if item.sight is None:
            pixels = points_in_photograph(vertices, right)
        else:  # the drift that was taken out of the points is there in the photograph
            on_grid = item.sight.in_view(*item.sight.project(vertices), 1)
            pixels = second_grid_in_photograph(on_grid, scene.rectified, right)
        height, width = right.photo.pixels_bgr.shape[:2]
        rings = rings_of_faces(pixels, item.volume.shape.faces, (width, height))
    else:
        places = photograph_px(
            scene.rectified, scene.points_table, right, is_swapped=not is_swapped
        )
        rings = rings_of(item.region.mask, places, is_swapped=not is_swapped)
    return (
        {"right_rings_px": [_rounded(ring, 1) for ring in rings], "right_rings_from": source}
        if rings
        else {}
    )


def _points(
    trace: Trace, scene: Reconstruction, spec: MarkerSpec | None, most: int
) -> tuple[Document, list[tuple[int, int]]]:
    """At most so many points, the foods' first; and (start, count) of each food's."""
    pair, usable = scene.rectified, _near(trace.items, scene, spec)
    foods = np.zeros(usable.shape, np.bool_)
    chosen = []
    # Well inside each mask: at its rim a window may have matched what lies behind.
    candidates = [
        np.flatnonzero(usable & (inward_px(item.region.mask) > scene.disparity.reach_px))
        for item in trace.items
    ]
    thinning = max(1.0, sum(map(len, candidates)) / max(FOOD_SHARE * most, 1.0))
    for item, own in zip(trace.items, candidates, strict=True):
        foods |= item.region.mask
        chosen.append(_evenly(own, pair.shape[1], int(len(own) / thinning)))
    rest = np.flatnonzero(usable & ~foods)
    ranges = [
        (int(start), len(own))
        for start, own in zip(np.cumsum([0, *map(len, chosen)]), chosen, strict=False)
    ]
    chosen.append(_evenly(rest, pair.shape[1], most - sum(map(len, chosen))))
    index = np.concatenate(chosen)
    painted = np.empty((0, 3), np.uint8)
    if len(index):  # a single view measures no point
        painted = apply_colour(pair.first_bgr.reshape(-1, 3)[index][None], trace.colour_of(0))[0]
    return {
        "positions": _quantised(_over_the_table(trace.table, scene, index)),
        "colours": _packed(painted[:, ::-1], "u1"),
    }, ranges


def _over_the_table(
    table: TableTrend | None, scene: Reconstruction, index: IntArray
) -> Float64Array:
    """(n, 3) mm of the grid's pixels at index (n,). Where the shapes' heights count from the table, so do these.

    That is, without the drift that views/sight.py takes out of the parallax around each food.
    """
    pair = scene.rectified
    points = scene.points_table.reshape(-1, 3)[index].astype(np.float64)
    if table is None:
        return points
    (a, b, c), camera = pair.plane_px, pair.first_centre_mm
    rows, columns = np.divmod(index, pair.shape[1])
    on_plane = camera + (points - camera) * (camera[2] / (camera[2] - points[:, 2]))[:, None]
    table_mm = table.height_mm(on_plane[:, :2])
    plane_px = a * columns + b * rows + c
    drift_px = plane_px * (camera[2] / (camera[2] - table_mm) - 1) / (1 - a)
    disparity = plane_px + (1 - a) * (scene.disparity.parallax_px.ravel()[index] - drift_px)
    depth = pair.focal_px * pair.baseline_mm / np.maximum(disparity, 1e-6)
    return np.asarray(
        (pair.rays(np.column_stack([columns, rows])) * depth[:, None]) @ pair.rotation + camera,
        np.float64,
    )


def _near(
    items: Sequence[MeasuredItem], scene: Reconstruction, spec: MarkerSpec | None
) -> MaskArray:
    """(H, W) where a point over the table about the board and the foods was measured; of neither, about the origin."""
    seen = [item.points_table[:, :2] for item in items if len(item.points_table)]
    half = np.array([spec.width_mm, spec.height_mm]) / 2 if spec is not None else np.zeros(2)
    board = [] if spec is None and seen else [np.array([-half, half])]
    corners = np.concatenate([*board, *seen])
    margin = AROUND_MM if seen else AROUND_BOARD_MM
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    x, y, z = (scene.points_table[..., axis] for axis in range(3))
    inside = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    return np.asarray(inside & (z > HEIGHTS_MM[0]) & (z < HEIGHTS_MM[1]), np.bool_)


def _evenly(index: IntArray, columns: int, most: int) -> IntArray:
    """At most so many of (n,) pixels of a grid with so many columns, spread evenly over their part of it."""
    if len(index) <= most:
        return index
    rows, places = np.divmod(index, columns)
    # The plane's counterpart of the golden ratio: whatever share of it is taken lies evenly, without rows or stripes.
    order = (PLASTIC * rows + PLASTIC**2 * places) % 1.0
    return index[np.sort(np.argsort(order, kind="stable")[: max(most, 0)])]


def _steps(values: Float64Array) -> tuple[Float64Array, Float64Array, IntArray]:
    """Offset (k,), scale (k,) and whole numbers (n, k) from -32768 on: value = offset + scale * number."""
    if len(values) == 0:
        return np.zeros(values.shape[1]), np.ones(values.shape[1]), np.zeros(values.shape, np.int64)
    low, high = values.min(axis=0), values.max(axis=0)
    scale = np.where(high > low, (high - low) / STEPS, 1.0)
    offset = low + scale * (STEPS + 1) / 2
    return (
        offset,
        scale,
        np.clip(np.rint((values - offset) / scale), -32768, 32767).astype(np.int64),
    )


def _unpacked(values: Float64Array) -> Float64Array:
    """(n, k) as whoever reads the file finds them."""
    offset, scale, whole = _steps(values)
    return offset + scale * whole


def _quantised(values: Float64Array) -> Document:
    offset, scale, whole = _steps(values)
    return {**_packed(whole, "<i2"), "offset": offset.tolist(), "scale": scale.tolist()}


def _packed(values: np.ndarray, kind: str) -> Document:
    """Rows of whole numbers as base64, little endian."""
    names = {"<i2": "int16", "<u2": "uint16", "u1": "uint8"}
    data = np.ascontiguousarray(values.astype(np.dtype(kind)))
    return {
        "type": names[kind],
        "shape": list(data.shape),
        "base64": base64.b64encode(data.tobytes()).decode("ascii"),
    }


def _rounded(values: Float64Array | tuple[float, ...], decimals: int) -> object:
    return (np.round(values, decimals) + 0.0).tolist()


def _number(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)
