"""More than two photographs: which one is the first one's stereo partner, and where the others were taken.

Photographs -> the pair that depth is measured on; photographs and the refined pair -> views in the pair's table frame,
each placed by the marker and its matches with the pair's first.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import (
    MAX_VIEW_ANGLE_DEG,
    MIN_VIEW_ANGLE_DEG,
    camera_from_exif,
    estimate_views,
)
from app.vision.board.marker import agree_on_corners, find_marker
from app.vision.board.pose import solve_pose
from app.vision.marker_spec import MarkerSpec
from app.vision.model import EstimateOptions, MarkerObservation, Photo, PhotoPair, View
from app.vision.views.epipolar import surely_on_epipolar_lines
from app.vision.views.features import match_features
from app.vision.views.relative_pose import RefinedViews, refine_views
from app.vision.views.stillness import judge_heights, judge_matches

# Between the lines of sight of a pair. The narrower it is, the surer do windows on plain food match, and the other
# photographs widen the base; narrower than this, the noise of disparities tells in depth.
LEAST_ANGLE_DEG = 2 * MIN_VIEW_ANGLE_DEG
MOST_PARTNERS = 2  # tried one after the other while they fail
MOST_ALONG = 0.7  # of the baseline, along an optical axis


def stereo_partners(pair: PhotoPair, marker: MarkerSpec) -> list[PhotoPair]:
    """The left photograph with up to MOST_PARTNERS in turn, the best first; at last as it was sent, if not among these.

    The best is the nearest that sees the marker at least LEAST_ANGLE_DEG from its line of sight, then those farther
    away, then those nearer.
    """
    left = find_marker(pair.left, marker) if pair.others else None
    if left is None or isinstance(left, Failure):
        return [pair]
    photos = [pair.both[1], *pair.others]
    angles = {index: _angle_deg(pair.left, left, photo) for index, photo in enumerate(photos)}
    seen = {index: angle for index, angle in angles.items() if angle is not None}
    best = sorted(
        seen, key=lambda index: (seen[index] < LEAST_ANGLE_DEG, abs(seen[index] - LEAST_ANGLE_DEG))
    )
    tried = best[:MOST_PARTNERS] if 0 in best[:MOST_PARTNERS] else [*best[:MOST_PARTNERS], 0]
    return [
        PhotoPair(pair.left, photos[index], (*photos[:index], *photos[index + 1 :]))
        for index in tried
    ]


def _angle_deg(left_photo: Photo, left: MarkerObservation, photo: Photo) -> float | None:
    """Angle between the lines of sight to the marker, by cameras of about this focal length; None if it is not seen."""
    observation = find_marker(photo, left.spec)
    if isinstance(observation, Failure):
        return None
    observations = agree_on_corners(PhotoPair(left_photo, photo), left, observation)
    poses = [
        solve_pose(camera_from_exif(each), observed)
        for each, observed in zip((left_photo, photo), observations, strict=True)
    ]
    sights = [-pose[0].T @ pose[1] for pose in poses if pose is not None]
    if len(sights) < 2:
        return None
    cosine = float(sights[0] @ sights[1] / (np.linalg.norm(sights[0]) * np.linalg.norm(sights[1])))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def place_other_views(
    photos: Sequence[Photo], pair: RefinedViews, options: EstimateOptions
) -> list[View]:
    """Views of the photographs in which the marker is seen and in which nothing moved against the pair's first.

    A photograph that cannot be placed adds nothing and costs nothing: the pair alone measures the meal.
    """
    placed = (_placed(photo, pair.first, options) for photo in photos)
    return [view for view in placed if view is not None]


def second_pair(first: View, second: View, others: Sequence[View]) -> tuple[View, View] | None:
    """The two views that are matched once more beside the pair, first and second; None where none are suited.

    The pair's first with that of the others whose line of sight to the marker is nearest; or any two views less than
    half as far apart as the first is from any other. Beyond MAX_VIEW_ANGLE_DEG windows on food are too different, and
    one behind the other shows no parallax.
    """
    with_first = _nearest([(first, other) for other in others])
    elsewhere = _nearest([*itertools.combinations((second, *others), 2)])
    if elsewhere is not None:
        own_deg = min(_sight_angle_deg(first, each) for each in (second, *others))
        if _sight_angle_deg(*elsewhere) < own_deg / 2:
            return _refined(*elsewhere)
    return with_first


def _nearest(pairs: Sequence[tuple[View, View]]) -> tuple[View, View] | None:
    """The pair whose lines of sight are nearest to each other, of those that can be matched."""
    angles = {
        index: _sight_angle_deg(*pair) for index, pair in enumerate(pairs) if _is_beside(*pair)
    }
    suited = {
        index: angle
        for index, angle in angles.items()
        if LEAST_ANGLE_DEG <= angle <= MAX_VIEW_ANGLE_DEG
    }
    return pairs[min(suited, key=lambda index: suited[index])] if suited else None


def _refined(first: View, second: View) -> tuple[View, View]:
    """Two views with poses by their own matches: those by matches with a third view leave rows apart."""
    matches = match_features(first, second)
    if matches.are_few:
        return first, second
    refined = refine_views(first, second, matches)
    return refined.first, refined.second


def _sight_angle_deg(first: View, other: View) -> float:
    """Between the lines of sight to the table frame's origin."""
    sights = [view.centre_mm / np.linalg.norm(view.centre_mm) for view in (first, other)]
    return float(np.degrees(np.arccos(np.clip(sights[0] @ sights[1], -1.0, 1.0))))


def _is_beside(first: View, other: View) -> bool:
    """Return whether the line between the cameras runs across both of their optical axes."""
    baseline = other.centre_mm - first.centre_mm
    along = [abs(float(view.rotation[2] @ baseline)) for view in (first, other)]
    return max(along) < MOST_ALONG * float(np.linalg.norm(baseline))


def _placed(photo: Photo, first: View, options: EstimateOptions) -> View | None:
    marker = first.required_marker
    observation = find_marker(photo, marker.spec)
    if isinstance(observation, Failure):
        return None
    both = PhotoPair(first.photo, photo)
    views = estimate_views(
        both, agree_on_corners(both, marker, observation), options, is_stereo=False
    )
    if isinstance(views, Failure):
        return None
    matches = match_features(*views)
    if matches.are_few:
        return None
    refined = refine_views(*views, matches)
    is_good = surely_on_epipolar_lines(refined.first, refined.second, matches) | matches.is_board
    judged = judge_heights(refined, matches), judge_matches(matches, is_good, placed_by="marker")
    return _by_first(refined, first) if judged == (None, None) else None


def _by_first(refined: RefinedViews, first: View) -> View:
    """The second of two refined views in the frame of another fit of the first one."""
    rotation = refined.second.rotation @ refined.first.rotation.T
    shift = refined.second.translation_mm - rotation @ refined.first.translation_mm
    return replace(
        refined.second,
        rotation=np.asarray(rotation @ first.rotation, np.float64),
        translation_mm=rotation @ first.translation_mm + shift,
    )
