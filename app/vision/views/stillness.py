"""Whether nothing moved between the two photographs: the table must lie at the marker, the matches on their lines.

A marker that was pushed along the line between the cameras leaves every match on its epipolar line, and lifts or sinks
all that is measured; pushed in any other way, it leaves few matches there. Either way volumes would be nonsense.
"""

from typing import Literal

import numpy as np

from app.core.errors import Failure
from app.vision.board.print_layout import sheet_half_mm
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float32Array, MaskArray, View
from app.vision.views.epipolar import surely_on_epipolar_lines
from app.vision.views.features import Matches, match_features
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.table_matches import points_of_matches

RING_MM = (0.0, 50.0)  # around the sheet: on the table, and seldom much of a plate
AT_MARKER_MM = 8.0  # over or under its plane: a bent sheet, or one on a place mat
# of what is measured in the ring; a plate's rim beside the sheet takes some of it
MIN_SHARE_AT_MARKER = 0.4
MIN_SHARE_ELSEWHERE = 0.4  # of the ring: what stands beside a marker covers less of it
MIN_SHARE_ON_LINES = 0.25  # of the matches beside the board; repeated patterns make wrong ones
MIN_JUDGED_MATCHES = 20
# more than a plaque is thick, and standard deviations of a match's height beyond it
UNDER_MM, UNDER_SD = 14.0, 3.0
SURE_HEIGHT_MM = 2.0  # standard deviation up to which a height is sure
MAX_SHARE_UNDER = 0.2  # of the matches: on a cloth whose pattern repeats some are wrong


def judge_matches(
    matches: Matches, is_good: MaskArray, *, placed_by: Literal["marker", "rig", "poses", "object"]
) -> Failure | None:
    """Failure if hardly a match beside the board lies on its epipolar line; None if enough do.

    is_good: (n,) whether a match does. "scene_moved" where the marker placed the cameras. A rig takes both photographs
    at once, so that nothing moves between them: "rig_mismatch". Of known poses: "poses_mismatch".
    """
    beside = ~matches.is_board
    judged, good = int(np.count_nonzero(beside)), int(np.count_nonzero(beside & is_good))
    if judged < MIN_JUDGED_MATCHES or good >= MIN_SHARE_ON_LINES * judged:
        return None
    placed = f"{judged} points were found again in the other photograph, but only {good} of them where the {placed_by}"
    if placed_by == "rig":
        return Failure(
            "rig_mismatch",
            f"The rig's calibration does not fit these photographs: {placed} puts them.",
            "Send the photographs that the rig's two cameras took at once, the left one first; calibrate the rig anew "
            "if its cameras may have moved.",
        )
    if placed_by == "poses":
        return poses_mismatch(
            f"{judged} points were found again in the other photograph, but only {good} of them near."
        )
    return _moved(
        f"The marker and the rest of the meal moved against each other: {placed} puts them."
    )


def judge_missing(first: View, second: View) -> Failure | None:
    """Why hardly a match lies near its epipolar line: failure "scene_moved" if there are others, else None.

    A plain scene has none anywhere, nor have two different scenes.
    """
    anywhere = match_features(first, second, gate_share=1.0)
    if anywhere.beside_board < MIN_JUDGED_MATCHES:
        return None
    return _moved(
        f"The marker and the rest of the meal moved against each other: {anywhere.beside_board} points were found "
        "again in the other photograph, but hardly one of them where the marker puts it."
    )


def poses_mismatch(reason: str) -> Failure:
    """Failure where matches contradict known poses. reason: a sentence's second half, with its full stop."""
    return Failure(
        "poses_mismatch",
        f"The poses do not fit these photographs: {reason}",
        "Send the pose of each photograph itself, of the moment when it was taken, in the convention that is named, "
        "and the file as the camera wrote it, with its EXIF orientation.",
    )


def judge_heights(views: RefinedViews, matches: Matches) -> Failure | None:
    """Failure "scene_moved" if much lies under the marker's plane, where nothing can be; None if hardly anything does.

    A marker pushed by some millimetres leaves the table tilted under it. Poses that are unsure tilt it as well: only
    matches whose heights are sure are judged.
    """
    sure = surely_on_epipolar_lines(views.first, views.second, matches)
    if np.count_nonzero(sure) < MIN_JUDGED_MATCHES:
        return None
    points, doubt_mm = points_of_matches(
        views.first, views.second, views.doubts, matches.first_px[sure], matches.second_px[sure]
    )
    heights, doubt_mm = points[doubt_mm < SURE_HEIGHT_MM, 2], doubt_mm[doubt_mm < SURE_HEIGHT_MM]
    is_under = heights < -UNDER_MM - UNDER_SD * doubt_mm
    if len(heights) < MIN_JUDGED_MATCHES or np.mean(is_under) < MAX_SHARE_UNDER:
        return None
    return _moved(
        f"Much of the scene seems to lie {-float(np.median(heights[is_under])):.0f} mm under the marker: one of them "
        "was moved between the two photographs, or the marker does not lie on the table."
    )


def judge_table(
    spec: MarkerSpec, plane_mm: Float32Array, points_table: Float32Array
) -> Failure | None:
    """Failure "scene_moved" if what surrounds the sheet does not lie at its height; None if it does or is not seen.

    plane_mm: (H, W, 3) where each line of sight meets the marker's plane. points_table: (H, W, 3) mm, NaN.
    """
    half = sheet_half_mm(spec)
    x, y = (np.maximum(np.abs(plane_mm[..., axis]) - np.float32(half[axis]), 0) for axis in (0, 1))
    beyond = np.sqrt(x * x + y * y)
    height = points_table[..., 2]
    ring = height[(beyond > RING_MM[0]) & (beyond < RING_MM[1])]
    around = ring[np.isfinite(ring)]
    at_marker = np.count_nonzero(np.abs(around) < AT_MARKER_MM)
    # On a plain table, only the foods beside the marker are measured: they are no table.
    is_table_seen = len(around) - at_marker > MIN_SHARE_ELSEWHERE * len(ring)
    if not is_table_seen or at_marker >= MIN_SHARE_AT_MARKER * len(around):
        return None
    middle = float(np.median(around))
    return _moved(
        f"The table around the marker seems to lie {abs(middle):.0f} mm {'over' if middle > 0 else 'under'} it: one of "
        "them was moved between the two photographs, or the marker does not lie on the table."
    )


def _moved(message: str) -> Failure:
    return Failure(
        "scene_moved",
        message,
        "Lay the marker flat on the table beside the plate, and move nothing between the two photographs.",
    )
