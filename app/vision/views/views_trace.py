"""The views of a run so far: filled step by step, for later steps and the record's parameters."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from app.vision.model import ColourCorrection, MarkerObservation, MaskArray, View
from app.vision.stages import Stages
from app.vision.views.epipolar import good_matches
from app.vision.views.features import Matches
from app.vision.views.focal_doubt import FocalDoubt
from app.vision.views.reconstruction import Reconstruction
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.single_view import SingleView

Scale = Literal["marker", "rig", "poses", "depth", "object"]  # what gives a scene its scale


@dataclass(slots=True)
class ViewsTrace:
    """Each step's result up to the points over the table; None or empty where the run ended before.

    stage: shared by a run's attempts.
    markers: as found in the (left, right) photograph.
    colours: corrections of the (left, right) photograph.
    views: (left, right) as sent; right is None where the left one is measured alone.
    is_swapped: the first view is the right one.
    matches: between the two views.
    is_good_match: (n,) those on their epipolar lines; off_lines_px: how far off these lie, the median.
    refined: first and second by where they stand.
    single: the view that is measured alone.
    others: further views that could be placed.
    second_place: which photograph stands for the right one, see MealEstimate.
    scale: where it comes from, known once the views are placed.
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
    is_good_match: MaskArray | None = None
    off_lines_px: float = 0.0
    scene: Reconstruction | None = None
    others: list[View] = field(default_factory=list)
    second_place: int = 1
    scale: Scale | None = None

    @property
    def is_by_marker_alone(self) -> bool:
        """Return whether no match took part in placing both views, which shows little of rest."""
        return self.scale == "marker" and self.refined is not None and self.refined.matches == 0

    @property
    def left_view(self) -> View:
        """Return the left photograph's view. Raises ValueError before it is placed."""
        if self.views is None:
            raise ValueError("The views are not placed yet.")
        return self.views[0]

    def keep_views(self, refined: RefinedViews) -> None:
        """Put refined views, and their markers, in the place of those before."""
        left, right = (
            (refined.second, refined.first) if self.is_swapped else (refined.first, refined.second)
        )
        self.refined = refined
        self.views = left, right
        self.markers = left.marker, right.marker

    def keep_matches(self, matches: Matches, refined: RefinedViews) -> MaskArray:
        """Keep matches and the views that they refined, and return (n,) which lie on their epipolar lines."""
        self.matches = matches
        self.keep_views(refined)
        is_good, distances_px = good_matches(refined.first, refined.second, matches)
        if is_good.any():
            self.is_good_match, self.off_lines_px = is_good, float(np.median(distances_px[is_good]))
        return is_good

    def keep_single(self, view: SingleView) -> None:
        """Keep the view of one photograph that is measured alone."""
        self.single = view
        self.views = view.first, None

    def forget_pair(self) -> None:
        """Drop what an attempt with both photographs left, before the left one is measured alone."""
        self.matches = self.refined = self.is_good_match = None
        self.is_swapped = False

    def colour_of(self, place: Literal[0, 1]) -> ColourCorrection:
        """The correction of the first or second view by where they stand. Raises ValueError before."""
        if self.colours is None:
            raise ValueError("Colours are measured on the markers, which are not found yet.")
        return self.colours[1 - place if self.is_swapped else place]

    def view_parameters(self) -> dict[str, object]:
        """What the record keeps of a run's views: their geometry and how well each step fitted."""
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
                # as it was announced or measured
                out["marker_thick_mm"] = self.refined.first.marker.spec.thick_mm
            if self.focal is not None:
                out["focal_log_sd"] = round(self.focal.log_sd, 3)
            if self.others:
                out["views"] = 2 + len(self.others)
            out["sheet_bend_mm"] = round(float(max(self.refined.bend_mm, key=abs)), 3)
        if self.matches is not None and self.is_good_match is not None:
            out |= {
                "matches": len(self.matches),
                "matches_food": int(self.matches.is_food.sum()),
                "matches_good": int(self.is_good_match.sum()),
                "epipolar_distance_calibrated_px": round(self.off_lines_px, 3),
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
        return out


def _of_view(name: str, view: View) -> dict[str, float | int | str]:
    """What the record keeps of a view's geometry."""
    k1, k2 = (round(coefficient, 4) for coefficient in view.camera.distortion[:2])
    return {
        f"focal_{name}_px": round(view.camera.fx, 2),
        f"k1_{name}": k1,
        f"k2_{name}": k2,
        f"lens_{name}": "given" if view.camera.source == "given" else "estimated",
        f"camera_height_{name}_mm": round(float(view.centre_mm[2]), 2),
    }
