"""Whether a pair can be measured, told while the plate is still there: the pipeline's first steps on reduced photos.

Two photographs, read at about 2000 px, and the announced board in -> problems with their codes, and what was measured.
Marker, poses and sparse matches are looked at; disparity and foods are not, so that a pair without problems may still
fail later. Limits that end in "stop" are the pipeline's; those that end in "warn" have their reason beside them.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif, estimate_views, view_angle_deg
from app.vision.board.grid import square_means
from app.vision.board.marker import agree_on_corners, contrast_image, find_marker
from app.vision.board.print_layout import border_share, seen_tags_px, shortest_side_px
from app.vision.board.quality import clipped_share, edge_width_limit_px, marker_edge_width_px
from app.vision.board.round_object import find_round_objects
from app.vision.board.search import find_grids
from app.vision.board.tag_bits import read_tag_cells
from app.vision.board.tag_edges import edge_profiles, edge_width_px
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.marker_spec import MarkerSpec, TagBoard
from app.vision.model import (
    EstimateOptions,
    Float64Array,
    ImageArray,
    MarkerObservation,
    PhotoPair,
    View,
)
from app.vision.photograph.photo import ReducedPhoto
from app.vision.views.epipolar import GATE_PX_AT_12MP, GOOD_PX_AT_12MP, near_epipolar_lines
from app.vision.views.features import FOOD_MAX_HEIGHT_MM, MIN_MATCHES, match_features, triangulate
from app.vision.views.relative_pose import fit_views
from app.vision.views.stillness import (
    AT_MARKER_MM,
    MIN_JUDGED_MATCHES,
    judge_matches,
    judge_missing,
)

# where matches are aligned (features.ALIGNED_SIDE_PX); a 12 MP photograph is read at 2016
LEAST_LONG_SIDE_PX = 1600
NEAR_BLUR_SHARE = 0.75  # of the width where measuring ends
# twice the least: the depth noise of 5 mm that is left there is a tenth of a 50 mm food
SMALL_ANGLE_DEG = 3.0
# an outline that is a pixel off moves the volume of a 60 mm food by 3 x 0.5 / 30 = 5 %
COARSE_MM_PER_PX = 0.5
# photographs below it are coarse by themselves; larger ones are taken too far off
LOW_RESOLUTION_LONG_SIDE_PX = 1600
MAX_CLIPPED_SHARE = 0.2  # of a photograph without any texture to match; a white plate fills less
GLARE_STEP_SHARE = 0.5  # a dark square this far up towards the light ones reflects a lamp
# a reduced square below it is too small for the corners' fit to accuse the board
SURE_STEP_PX = 12.0
BORDER_SHARE = 0.03  # of the long side; nearer, the rest of the food is as likely outside
# over the marker's plane: food, not a plate's rim; sparse heights are good to 5 mm
RAISED_MM = 15.0
LEAST_AT_BORDER = (3, 0.1)  # raised matches, and their share of all: one may be wrong
# of what is seen; nothing lies under the table that the marker lies on
MAX_SHARE_UNDER_MARKER = 0.5

SideName = Literal["left", "right"]
Severity = Literal["stop", "warn"]
SIDES: tuple[SideName, SideName] = ("left", "right")


@dataclass(frozen=True, slots=True)
class PairProblem:
    """One thing to do better. stop: it will not be measured. warn: it will, but worse. side None: of the pair."""

    code: str
    severity: Severity
    side: SideName | None = None


@dataclass(frozen=True, slots=True)
class PairCheck:
    """problems: those that stop first. measures: by name with its unit, those that could be had."""

    problems: tuple[PairProblem, ...]
    measures: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_ok(self) -> bool:
        """Whether nothing stops the pair from being measured."""
        return all(problem.severity != "stop" for problem in self.problems)


@dataclass(frozen=True, slots=True)
class _Side:
    """What one photograph shows by itself."""

    problems: tuple[PairProblem, ...]
    measures: Mapping[str, float]
    seen: tuple[ReducedPhoto, MarkerObservation] | None = None


def check_pair(
    left: ReducedPhoto | Failure,
    right: ReducedPhoto | Failure,
    spec: MarkerSpec | KnownObject,
    camera: Camera | None,
) -> PairCheck:
    """Judge a pair. A Failure stands for a photograph that could not be read. camera: as in EstimateOptions."""
    # OpenCV lets go of the interpreter while it looks for the board
    with ThreadPoolExecutor(2) as threads:
        first, second = threads.map(_judge_side, SIDES, (left, right), (spec, spec))
    problems = [*first.problems, *second.problems]
    measures = {**first.measures, **second.measures}
    if first.seen is not None and second.seen is not None:
        of_pair, more = _judge_views(first.seen, second.seen, camera)
        problems += of_pair
        measures |= more
    ordered = sorted(problems, key=lambda problem: problem.severity != "stop")
    return PairCheck(tuple(ordered), {name: round(value, 3) for name, value in measures.items()})


def _judge_side(
    side: SideName, read: ReducedPhoto | Failure, spec: MarkerSpec | KnownObject
) -> _Side:
    if isinstance(read, Failure):
        return _Side((PairProblem(read.code, "stop", side),), {})
    problems = []
    pixels_bgr = read.photo.pixels_bgr
    clipped = clipped_share(pixels_bgr)
    measures = {f"clipped_share_{side}": clipped}
    if clipped > MAX_CLIPPED_SHARE:
        problems.append(PairProblem("image_too_bright", "warn", side))
    if isinstance(spec, KnownObject):
        seen = find_round_objects(read.photo, camera_from_exif(read.photo), spec, side)
        if isinstance(seen, Failure):
            return _stopped(side, seen.code, measures, problems)
        return _Side(tuple(problems), measures)
    marker = find_marker(read.photo, spec, side)
    if isinstance(marker, Failure):
        is_cut_off = marker.code == "marker_covered" and _leaves_photograph(pixels_bgr)
        code = "marker_cut_off" if is_cut_off else marker.code
        return _stopped(side, code, measures, problems)
    contrast = contrast_image(pixels_bgr, is_coloured=spec.is_coloured)
    width_px = _edge_width_px(contrast, marker) * read.factor
    limit_px = edge_width_limit_px(max(contrast.shape) * read.factor)
    measures |= {
        f"edge_width_px_{side}": width_px,
        f"square_px_{side}": shortest_side_px(marker) * read.factor,
    }
    if width_px > limit_px:
        return _stopped(side, "image_blurred", measures, problems)
    if width_px > NEAR_BLUR_SHARE * limit_px:
        problems.append(PairProblem("image_blurred", "warn", side))
    if _has_glare(contrast, marker):
        problems.append(PairProblem("marker_glare", "warn", side))
    return _Side(tuple(problems), measures, (read, marker))


def _stopped(
    side: SideName, code: str, measures: Mapping[str, float], problems: list[PairProblem]
) -> _Side:
    return _Side((PairProblem(code, "stop", side), *problems), measures)


def _leaves_photograph(pixels_bgr: ImageArray) -> bool:
    """Whether the part of a board that is seen goes on beyond the photograph's border."""
    contrast = contrast_image(pixels_bgr, is_coloured=True)
    grid = next(find_grids(contrast), None)
    return grid is not None and bool(np.isnan(square_means(contrast, grid, ring=1)).any())


def _edge_width_px(contrast: ImageArray, marker: MarkerObservation) -> float:
    """Width of the marker's edges, px. contrast: (H, W)."""
    spec = marker.spec
    if not isinstance(spec, TagBoard):
        return marker_edge_width_px(contrast, marker.grid_px)
    _, quads_px = seen_tags_px(marker, spec)
    return edge_width_px(edge_profiles(contrast, quads_px, border_share(spec)))


def _has_glare(contrast: ImageArray, marker: MarkerObservation) -> bool:
    """Whether a square, or the black of a tag, looks light. contrast: (H, W)."""
    spec = marker.spec
    if not isinstance(spec, TagBoard):
        means = square_means(contrast, marker.grid_px)
        is_even = np.indices(means.shape).sum(axis=0) % 2 == 0
        is_dark = is_even == spec.first_is_dark
        darks, lights = means[is_dark], means[~is_dark]
    else:
        tags = zip(*seen_tags_px(marker, spec), strict=True)
        cells = [read_tag_cells(contrast, spec, int(tag), quad) for tag, quad in tags]
        darks, lights = (np.array([np.median(tag[place]) for tag in cells]) for place in (0, 1))
    dark, light = float(np.nanmedian(darks)), float(np.nanmedian(lights))
    return bool(np.nanmax(darks) > dark + GLARE_STEP_SHARE * (light - dark))


def _judge_views(
    left: tuple[ReducedPhoto, MarkerObservation],
    right: tuple[ReducedPhoto, MarkerObservation],
    camera: Camera | None,
) -> tuple[list[PairProblem], dict[str, float]]:
    """What both together show: where the cameras stood, and whether they saw the same meal."""
    photos, markers = (left[0], right[0]), (left[1], right[1])
    pair, spec = PhotoPair(photos[0].photo, photos[1].photo), markers[0].spec
    views = estimate_views(pair, agree_on_corners(pair, *markers), EstimateOptions(spec, camera))
    if isinstance(views, Failure):
        steps = [shortest_side_px(marker) for marker in markers]
        is_sure = views.code != "pose_unreliable" or min(steps) >= SURE_STEP_PX
        return [PairProblem(views.code, "stop" if is_sure else "warn")], {}
    measures = {
        "view_angle_deg": view_angle_deg(*views),
        "baseline_mm": float(np.linalg.norm(views[0].centre_mm - views[1].centre_mm)),
    }
    problems = []
    if measures["view_angle_deg"] < SMALL_ANGLE_DEG:
        problems.append(PairProblem("baseline_too_small", "warn"))
    for side, view, photo in zip(SIDES, views, photos, strict=True):
        distance_mm = float(np.linalg.norm(view.centre_mm))
        mm_per_px = distance_mm / (view.camera.fx * photo.factor)
        measures |= {f"distance_mm_{side}": distance_mm, f"mm_per_px_{side}": mm_per_px}
        if mm_per_px > COARSE_MM_PER_PX:
            is_small = (
                max(view.camera.width, view.camera.height) * photo.factor
                < LOW_RESOLUTION_LONG_SIDE_PX
            )
            code = "resolution_low" if is_small else "marker_too_small"
            problems.append(PairProblem(code, "warn", side))
    of_scene, matched = _judge_scene(*views)
    return problems + of_scene, measures | matched


def _judge_scene(left: View, right: View) -> tuple[list[PairProblem], dict[str, float]]:
    """Judge whether both photographs show one scene at rest on the marker's table, well inside both.

    One fit of the views is enough: heights are judged by RAISED_MM, and lines by GOOD_PX_AT_12MP.
    """
    matches = match_features(left, right)
    near = near_epipolar_lines(left, right, matches, GATE_PX_AT_12MP)
    views = (left, right)
    if np.count_nonzero(near) >= MIN_MATCHES:  # fewer may be near by chance
        fitted = fit_views(left, right, matches.first_px[near], matches.second_px[near])
        views = (fitted.first, fitted.second)
    is_good = near_epipolar_lines(*views, matches, GOOD_PX_AT_12MP)
    are_few = np.count_nonzero(is_good) < MIN_MATCHES
    measures = {"matches": float(np.count_nonzero(is_good))}
    moved = judge_matches(matches, is_good, placed_by="marker")
    if moved is None and are_few:
        moved = judge_missing(left, right)
    if moved is not None:
        return [PairProblem(moved.code, "stop")], measures
    if are_few:
        return [PairProblem("too_few_matches", "warn")], measures
    pixels = (matches.first_px[is_good], matches.second_px[is_good])
    points = triangulate(*views, *pixels)
    height_mm = np.nan_to_num(points[:, 2])
    if (
        len(points) >= MIN_JUDGED_MATCHES
        and np.mean(height_mm < -AT_MARKER_MM) > MAX_SHARE_UNDER_MARKER
    ):
        return [PairProblem("scene_moved", "stop")], measures
    is_raised = (height_mm > RAISED_MM) & (height_mm < FOOD_MAX_HEIGHT_MM)
    problems = [
        PairProblem("food_near_border", "warn", side)
        for side, view, at in zip(SIDES, (left, right), pixels, strict=True)
        if _is_cut(at[is_raised], view.camera.width, view.camera.height)
    ]
    return problems, measures


def _is_cut(at_px: Float64Array, width: int, height: int) -> bool:
    """Whether raised points, (n, 2) px, crowd at one border of the photograph."""
    if len(at_px) == 0:
        return False
    border = BORDER_SHARE * max(width, height)
    x, y = at_px.T
    counts = [
        np.count_nonzero(side)
        for side in (x < border, x > width - border, y < border, y > height - border)
    ]
    fewest, share = LEAST_AT_BORDER
    return bool(max(counts) >= max(fewest, share * len(at_px)))
