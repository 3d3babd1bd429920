"""Corners of printed tags to a tenth of a pixel, by straight lines along their black borders; how wide those edges are.

Grey levels and tags' corners right within a pixel or two in -> refined corners. Blur rounds a black corner off, and a
camera's tone curve makes black look smaller: corners found one by one lie half a pixel inside. Lines run through the
borders' straight parts, and how much too small tags look is read off the gaps between them.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.pictures import sampled
from app.vision.geometry.projective import map_points
from app.vision.model import Float64Array, ImageArray, MaskArray

# of a side, where it is crossed: blur reaches in from the other sides
ALONG = np.linspace(0.12, 0.88, 15)
ACROSS_STEPS = 25  # of a profile across a side
REACH_SHARE = 0.75  # of the narrower of border and gap: farther out are bits, or the next tag
MIN_REACH_PX = 1.5
MIN_STEP = 15.0  # grey levels from black to white; noise of a phone's dark areas is below 4
ROUNDS = 2  # the second crosses the sides where the first found them
LINE_ROUNDS, LINE_SCALE_PX = 4, 0.5  # Cauchy weights: a crumb on a side loses its say


@dataclass(frozen=True, slots=True)
class EdgeProfiles:
    """Grey levels across tags' sides, from black to white.

    levels: (n, 4, k, m). at_px: (m,) or (n, 4, 1, m), how far outwards each lies.
    """

    levels: Float64Array
    at_px: Float64Array

    @property
    def dark(self) -> Float64Array:
        """(n, 4, k) the darkest of the black end."""
        return np.asarray(self.levels[..., : ACROSS_STEPS // 4].min(axis=-1), np.float64)

    @property
    def light(self) -> Float64Array:
        """(n, 4, k) the lightest of the white end."""
        return np.asarray(self.levels[..., -(ACROSS_STEPS // 4) :].max(axis=-1), np.float64)


def refine_tags(grey: ImageArray, corners_px: Float64Array, border_share: float) -> Float64Array:
    """(n, 4, 2) where the lines along each tag's sides meet; a side that cannot be made out stays where it was.

    corners_px: (n, 4, 2) px, in order around each tag. border_share: of a tag's side, the narrower of its black border
    and the white around it.
    """
    refined = corners_px
    for _ in range(ROUNDS):
        profiles = edge_profiles(grey, refined, border_share)
        offset_px, is_found = _crossings(profiles)
        start_px, end_px = _fit_offsets(offset_px, is_found)
        refined = _corners_of_sides(refined, start_px, end_px)
    return refined


def ink_gain_px(corners_px: Float64Array, corners_mm: Float64Array) -> float:
    """How far tags' edges lie inside of where the print has them, px; negative: outside.

    (n, 4, 2) each. The tags' middles, which it does not move, tell how large tags should look.
    """
    middle_px, middle_mm = corners_px.mean(axis=1), corners_mm.mean(axis=1)
    homography = cv2.findHomography(middle_mm, middle_px)[0]
    expected = map_points(homography, corners_mm.reshape(-1, 2)).reshape(corners_px.shape)
    return float(np.median(_side_lengths(expected) - _side_lengths(corners_px)) / 2)


def grow_tags(corners_px: Float64Array, by_px: float) -> Float64Array:
    """(n, 4, 2) with each side moved outwards."""
    by = np.full(corners_px.shape[:2], by_px)
    return _corners_of_sides(corners_px, by, by)


def edge_profiles(grey: ImageArray, corners_px: Float64Array, border_share: float) -> EdgeProfiles:
    """Profiles across the sides of tags (n, 4, 2); arguments as refine_tags."""
    ends = np.roll(corners_px, -1, axis=1)
    length = np.linalg.norm(ends - corners_px, axis=-1, keepdims=True)  # (n, 4, 1)
    reach = np.maximum(REACH_SHARE * border_share * length, MIN_REACH_PX)
    outwards = reach * np.linspace(-1.0, 1.0, ACROSS_STEPS)  # (n, 4, m)
    # along a side, for each of its k places
    on_side = corners_px[:, :, None] + (ends - corners_px)[:, :, None] * ALONG[:, None]
    across = _normals(corners_px)[:, :, None] * outwards[..., None]  # (n, 4, m, 2)
    places = on_side[:, :, :, None] + across[:, :, None]
    flat = sampled(grey.astype(np.float32), places.reshape(4 * len(places), -1, 2), beyond=None)
    return EdgeProfiles(flat.reshape(places.shape[:-1]).astype(np.float64), outwards[:, :, None])


def edge_width_px(profiles: EdgeProfiles) -> float:
    """Median width of tags' edges, px, from a tenth to nine tenths of the step; inf where no edge has contrast."""
    step_px = profiles.at_px[..., 1:] - profiles.at_px[..., :-1]
    steepest = (np.diff(profiles.levels, axis=-1) / step_px).max(axis=-1)
    step = profiles.light - profiles.dark
    has_edge = (step > MIN_STEP) & (steepest > 0)
    if not has_edge.any():
        return float("inf")
    return float(np.median(0.8 * step[has_edge] / steepest[has_edge]))


def _crossings(profiles: EdgeProfiles) -> tuple[Float64Array, MaskArray]:
    """(n, 4, k) px outwards where each profile passes the middle between black and white, and whether it does."""
    levels, dark, light = profiles.levels, profiles.dark, profiles.light
    middle = ((dark + light) / 2)[..., None]
    rises = (levels[..., :-1] <= middle) & (levels[..., 1:] > middle)
    from_centre = np.abs(np.arange(ACROSS_STEPS - 1) - (ACROSS_STEPS - 2) / 2)
    at = np.where(rises, from_centre, np.inf).argmin(axis=-1)[..., None]
    is_found = np.take_along_axis(rises, at, axis=-1)[..., 0] & (light - dark > MIN_STEP)
    low, high = (np.take_along_axis(levels, at + step, axis=-1) for step in (0, 1))
    share = np.where(high > low, (middle - low) / np.where(high > low, high - low, 1.0), 0.0)
    at_px = np.broadcast_to(profiles.at_px, levels.shape)
    start, end = (np.take_along_axis(at_px, at + step, axis=-1) for step in (0, 1))
    offset = (start + share * (end - start))[..., 0]
    return np.where(is_found, offset, 0.0), np.asarray(is_found)


def _fit_offsets(offset_px: Float64Array, is_found: MaskArray) -> tuple[Float64Array, Float64Array]:
    """(n, 4) each: how far outwards each side's line lies at its start and at its end, px."""
    design = np.stack([np.ones_like(ALONG), ALONG], axis=1)
    weight = is_found.astype(np.float64)
    line = np.zeros((*offset_px.shape[:2], 2))
    for _ in range(LINE_ROUNDS):
        normal = np.einsum("nsk,ki,kj->nsij", weight, design, design) + 1e-6 * np.eye(2)
        moment = np.einsum("nsk,ki,nsk->nsi", weight, design, offset_px)
        line = np.linalg.solve(normal, moment[..., None])[..., 0]
        off = offset_px - line @ design.T
        weight = is_found / (1.0 + (off / LINE_SCALE_PX) ** 2)
    return line[..., 0], line.sum(axis=-1)


def _corners_of_sides(
    corners_px: Float64Array, start_px: Float64Array, end_px: Float64Array
) -> Float64Array:
    """(n, 4, 2) where neighbouring sides meet, each moved outwards by (n, 4) px at its start and at its end."""
    normals, ends = _normals(corners_px), np.roll(corners_px, -1, axis=1)
    ones = np.ones((*corners_px.shape[:2], 1))
    start = np.concatenate([corners_px + normals * start_px[..., None], ones], axis=-1)
    end = np.concatenate([ends + normals * end_px[..., None], ones], axis=-1)
    lines = np.cross(start, end)
    meeting = np.cross(np.roll(lines, 1, axis=1), lines)
    return np.asarray(meeting[..., :2] / meeting[..., 2:], np.float64)


def _normals(corners_px: Float64Array) -> Float64Array:
    """(n, 4, 2) unit normals of each tag's sides, outwards."""
    ends = np.roll(corners_px, -1, axis=1)
    along = (ends - corners_px) / np.linalg.norm(ends - corners_px, axis=-1, keepdims=True)
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    from_middle = (corners_px + ends) / 2 - corners_px.mean(axis=1, keepdims=True)
    is_inwards = (from_middle * normals).sum(axis=-1, keepdims=True) < 0
    return np.where(is_inwards, -normals, normals)


def _side_lengths(corners_px: Float64Array) -> Float64Array:
    """(n, 4) px."""
    return np.asarray(
        np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=-1), np.float64
    )
