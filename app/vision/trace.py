"""The results of a run so far: filled step by step, read by figures.py and for the record's parameters."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from app.vision.geometry.topview import TableTrend, usable_points
from app.vision.model import ColourCorrection, Float32Array, MarkerObservation, MaskArray, View
from app.vision.paper.printed_stereo import PrintedStereo
from app.vision.scene.segmentation import Foods, rim_radii_mm
from app.vision.solids.measured_item import MeasuredItem
from app.vision.views.disparity import DisparityMap
from app.vision.views.epipolar import Epipolar
from app.vision.views.features import Matches
from app.vision.views.focal_doubt import FocalDoubt
from app.vision.views.reconstruction import DepthModel
from app.vision.views.rectification import RectifiedPair
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.single_view import SingleView

Scale = Literal["marker", "rig", "poses", "depth"]  # what gives a scene its scale


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """The rectified pair with its points, (H, W, 3) mm in the views' table frame.

    is_ignored: (H, W) the marker, and what one view misses. depths: the photographs' depth maps on the pair's grid, in
    its scale. flags: of every item.
    """

    rectified: RectifiedPair
    disparity: DisparityMap
    depth: DepthModel
    points_table: Float32Array
    is_ignored: MaskArray
    depths: tuple[DisparityMap, ...] = ()
    flags: tuple[str, ...] = ()

    def table_points(self) -> Float32Array:
        """(n, 3) mm, measured beside the marker; every second pixel each way."""
        points, ignored = self.points_table[::2, ::2], self.is_ignored[::2, ::2]
        return points[usable_points(points, ignored)]


class Stages:
    """Reports each stage when it begins for the first time, and keeps how long it took in all, seconds."""

    def __init__(self, on_stage: Callable[[str], None] = lambda _: None) -> None:
        self.seconds: dict[str, float] = {}
        self._on_stage = on_stage

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a stage, which may be entered again."""
        if name not in self.seconds:  # a plaque's scene is reconstructed again
            self._on_stage(name)
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started


@dataclass(slots=True)
class Trace:
    """Each step's result, None or empty where the run ended before.

    stage: shared by a run's attempts. views: (left, right) as sent; right is None where the left one is measured alone.
    single: that one. refined: first and second by where they stand; is_swapped: first is the right one.
    markers: as found in the (left, right) photograph. table: how it departs from the marker's plane, where heights
    count from it (the default method); None: they count from that plane. items: measured foods. others: further views
    that could be placed. printed: the stereo of the method paper-strict. colours: corrections of the (left, right)
    photograph. second_place: which photograph stands for the right one, see MealEstimate. scale: where it comes from,
    known once the views are placed. foods: what stands on the table.
    """

    stage: Stages = field(default_factory=Stages)
    markers: tuple[MarkerObservation | None, MarkerObservation | None] = (None, None)
    colours: tuple[ColourCorrection, ColourCorrection] | None = None
    views: tuple[View, View | None] | None = None
    is_swapped: bool = False
    matches: Matches | None = None
    refined: RefinedViews | None = None
    single: SingleView | None = None
    focal: FocalDoubt | None = None
    epipolar: Epipolar | None = None
    scene: Reconstruction | None = None
    table: TableTrend | None = None
    items: list[MeasuredItem] = field(default_factory=list)
    others: list[View] = field(default_factory=list)
    printed: PrintedStereo | None = None
    second_place: int = 1
    scale: Scale | None = None
    foods: Foods | None = None

    @property
    def is_by_marker_alone(self) -> bool:
        """Return whether no match took part in placing both views: hardly anything shows that the scene was at rest."""
        return self.scale == "marker" and self.refined is not None and self.refined.matches == 0

    def keep_views(self, refined: RefinedViews) -> None:
        """Put refined views, and their markers, in the place of those before."""
        left, right = (
            (refined.second, refined.first) if self.is_swapped else (refined.first, refined.second)
        )
        self.refined = refined
        self.views = left, right
        self.markers = left.marker, right.marker

    def keep_single(self, view: SingleView) -> None:
        """Keep the view of one photograph that is measured alone."""
        self.single = view
        self.views = view.first, None

    def colour_of(self, place: Literal[0, 1]) -> ColourCorrection:
        """The correction of the first or the second view by where they stand. Raises ValueError before the marker."""
        if self.colours is None:
            raise ValueError("Colours are measured on the markers, which are not found yet.")
        return self.colours[1 - place if self.is_swapped else place]

    def parameters(self) -> dict[str, object]:
        """What the record keeps of a run: the views' geometry and how well each step fitted."""
        # the number in its slot's name; 2: the right one
        out: dict[str, object] = (
            {} if self.second_place == 1 else {"second_view": self.second_place + 1}
        )
        out |= {} if self.scale is None else {"scale_source": self.scale}
        if self.single is not None:
            marker = self.single.first.marker
            out |= _of_view("first", self.single.first) | {"views": 1}
            out |= {} if marker is None else {"marker_thick_mm": marker.spec.thick_mm}
        if self.refined is not None:
            out |= _of_view("first", self.refined.first) | _of_view("second", self.refined.second)
            out |= {"swapped": int(self.is_swapped), "pose_matches": self.refined.matches}
            if self.refined.first.marker is not None:
                out["marker_thick_mm"] = (
                    self.refined.first.marker.spec.thick_mm
                )  # announced, or measured
            if self.focal is not None:
                out["focal_log_sd"] = round(self.focal.log_sd, 3)
            if self.others:
                out["views"] = 2 + len(self.others)
            out["sheet_bend_mm"] = round(float(max(self.refined.bend_mm, key=abs)), 3)
        if self.matches is not None and self.epipolar is not None:
            out |= {
                "matches": len(self.matches),
                "matches_food": int(self.matches.is_food.sum()),
                "matches_good": int(self.epipolar.is_good.sum()),
                "epipolar_distance_8_point_px": round(self.epipolar.matches_distance_px, 3),
                "epipolar_distance_calibrated_px": round(self.epipolar.views_distance_px, 3),
            }
        if self.scene is not None and self.single is not None:
            out["rectified_focal_px"] = round(self.scene.rectified.focal_px, 2)
        elif self.scene is not None:
            pair, depth = self.scene.rectified, self.scene.depth
            out["baseline_mm"] = round(pair.baseline_mm, 2)
            out["rectified_focal_px"] = round(pair.focal_px, 2)
            out["depth_p_mm"] = round(depth.p_mm, 3)
            out["depth_q_over_focal_baseline"] = round(
                depth.q_mm_px / (pair.focal_px * pair.baseline_mm), 5
            )
        out |= {} if self.foods is None else {"rim_radii_mm": rim_radii_mm(self.foods)}
        if self.printed is not None:
            out["printed_depth_p_mm"] = round(self.printed.depth.p_mm, 3)
            out["printed_depth_q_mm_px"] = round(self.printed.depth.q_mm_px, 3)
        return out


def _of_view(name: str, view: View) -> dict[str, float | int | str]:
    """What the record keeps of a view's geometry."""
    k1, k2 = (round(each, 4) for each in view.camera.distortion[:2])
    return {
        f"focal_{name}_px": round(view.camera.fx, 2),
        f"k1_{name}": k1,
        f"k2_{name}": k2,
        f"lens_{name}": "given" if view.camera.source == "given" else "estimated",
        f"camera_height_{name}_mm": round(float(view.centre_mm[2]), 2),
    }
