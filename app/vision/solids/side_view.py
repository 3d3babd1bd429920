"""A photograph from the side, which shares no surface with the first and shows a food's height by its outline.

Where it was taken from, nothing else tells: the camera's place is fitted together with the form. The camera of a pose
looks at the food, so that the pose's shift stands for where the food is in the photograph.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from app.vision.geometry.projective import pixel_gradient
from app.vision.model import Float64Array, MaskArray
from app.vision.solids.fields import OutlineField, outline_field
from app.vision.solids.outline_snap import Outline, outline, rings_of_mask
from app.vision.tuning import SIDE_TUNING as TUNING

# A pose's numbers: radians around the food's axis and over its support, and about the line of sight; the logarithm of
# the distance, mm; where the food's middle is seen, px.
AZIMUTH, ELEVATION, ROLL, LOG_DISTANCE = range(4)
SHIFT = slice(4, 6)
POSE = 6
STEP = np.array([1e-4, 1e-4, 1e-4, 1e-4, 0.1, 0.1])  # of the differences
STRIDE = np.array(TUNING.pose_stride)


@dataclass(frozen=True)
class SideView:
    """mask: (H, W) of the food in a picture. outline: of it, px there. middle_mm: (3,) a point in the food."""

    mask: MaskArray
    outline: Outline
    focal_px: float
    middle_mm: Float64Array

    @cached_property
    def field(self) -> OutlineField:
        """The outline as a field."""
        return outline_field(self.outline)

    def camera_mm(self, pose: Float64Array) -> Float64Array:
        """(3,) centre of the camera."""
        away = _rotation(pose)[2]
        return np.asarray(self.middle_mm - np.exp(pose[LOG_DISTANCE]) * away, np.float64)

    def project(self, points: Float64Array, pose: Float64Array) -> Float64Array:
        """(n, 3) mm -> (n, 2) px."""
        seen = self._in_camera(points, pose)
        return self.focal_px * seen[:, :2] / seen[:, 2:] + pose[SHIFT]

    def pixel_gradient(self, points: Float64Array, pose: Float64Array) -> Float64Array:
        """(n, 2, 3) derivative of the pixel by the point, px/mm."""
        return pixel_gradient(self._in_camera(points, pose), _rotation(pose), self.focal_px)

    def pose_gradient(self, points: Float64Array, pose: Float64Array) -> Float64Array:
        """(n, 2, POSE) derivative of the pixel by the pose."""
        moved = [
            self.project(points, pose + step) - self.project(points, pose - step)
            for step in np.diag(STEP)
        ]
        return np.asarray(np.stack(moved, axis=-1) / (2 * STEP), np.float64)

    def begin(self, vertices: Float64Array) -> Float64Array:
        """Return the pose (POSE,) by which vertices (n, 3) cover most of the mask and least beside it.

        They are as wide as the mask there, and may become as high: a height is what is least known.
        """
        tried = [
            self._framed(vertices, azimuth)
            for azimuth in np.arange(TUNING.azimuths) * np.pi / TUNING.azimuths
        ]
        return max(tried, key=lambda each: each[1])[0]

    def _in_camera(self, points: Float64Array, pose: Float64Array) -> Float64Array:
        out = (points - self.middle_mm) @ _rotation(pose).T
        out[:, 2] += np.exp(pose[LOG_DISTANCE])
        return out

    def _framed(self, vertices: Float64Array, azimuth: float) -> tuple[Float64Array, float]:
        """Return the pose from an azimuth by which vertices are as wide as the mask, and how well they fit."""
        left, top, wide, high = cv2.boundingRect(self.mask.astype(np.uint8))
        middle = np.array([left, top]) + (np.array([wide, high]) - 1) / 2
        pose = np.array([azimuth, TUNING.elevation, 0.0, 0.0, 0.0, 0.0])
        across = np.ptp((vertices - self.middle_mm) @ _rotation(pose)[0])
        pose[LOG_DISTANCE] = np.log(self.focal_px * across / wide)
        factor, raised, begun = 1.0, vertices, pose
        for _ in range(TUNING.raising_rounds):
            seen = self.project(raised, pose)
            pose[SHIFT] += middle - (seen.min(axis=0) + seen.max(axis=0)) / 2
            begun = pose.copy() if factor == 1.0 else begun
            factor *= high / np.ptp(seen[:, 1])
            raised = vertices * [1.0, 1.0, factor]
        overlap = self._overlap(raised, pose)
        return begun, overlap * float(np.exp(-0.5 * (np.log(factor) / TUNING.height_sd) ** 2))

    def _overlap(self, vertices: Float64Array, pose: Float64Array) -> float:
        """Intersection over union of the mask and the hull of what is seen of vertices."""
        hull = cv2.convexHull(np.rint(self.project(vertices, pose)).astype(np.int32))
        drawn = cv2.fillConvexPoly(np.zeros(self.mask.shape, np.uint8), hull, 1) > 0
        return float(np.count_nonzero(drawn & self.mask) / np.count_nonzero(drawn | self.mask))


def side_view(mask: MaskArray, focal_px: float) -> SideView | None:
    """Return the view of a mask (H, W) in a picture, of a food at the origin; None where nothing is left of it."""
    rings = rings_of_mask(mask)
    if not rings:
        return None
    line = outline(rings, np.ones(sum(len(ring.points_px) for ring in rings)))
    return SideView(mask, line, focal_px, np.zeros(3))


def pose_prior(start: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the middle (POSE,) and the precision (POSE, POSE) of a pose that begins somewhere."""
    expected = start.copy()
    expected[[ELEVATION, ROLL]] = TUNING.elevation, 0.0
    return expected, np.diag(1.0 / np.square(TUNING.pose_sd))


def _rotation(pose: Float64Array) -> Float64Array:
    """(3, 3) table to camera: to the right, down, away from the camera."""
    azimuth, elevation, roll = pose[[AZIMUTH, ELEVATION, ROLL]]
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    away = -np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    down = np.cross(away, right)
    turned = np.cos(roll) * right + np.sin(roll) * down
    return np.stack([turned, np.cross(away, turned), away])
