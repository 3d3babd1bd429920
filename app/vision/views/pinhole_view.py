"""A further photograph of the scene without its distortion, at the working grid's resolution, with its projection.

View in -> picture, and how it sees points (mm, table frame): pixels and how these change with the points.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.pictures import reduce_by
from app.vision.geometry.projective import pixel_gradient
from app.vision.model import Float64Array, ImageArray, View

# of the picture: a view from nearer by may show more of each food, not more of the table
MAX_SIDE_PX = 1600


@dataclass(frozen=True, slots=True)
class PinholeView:
    """picture_bgr: (H, W, 3). rotation: (3, 3) table to camera. centre_mm: (3,) of the camera, table frame."""

    picture_bgr: ImageArray
    focal_px: float
    middle_px: tuple[float, float]
    rotation: Float64Array
    centre_mm: Float64Array

    def project(self, points_table: Float64Array) -> Float64Array:
        """(n, 3) mm -> (n, 2) px."""
        in_camera = (points_table - self.centre_mm) @ self.rotation.T
        return self.focal_px * in_camera[:, :2] / in_camera[:, 2:] + self.middle_px

    def pixel_gradient(self, points_table: Float64Array) -> Float64Array:
        """(n, 2, 3) derivative of the pixel by the point, px/mm."""
        in_camera = (points_table - self.centre_mm) @ self.rotation.T
        return pixel_gradient(in_camera, self.rotation, self.focal_px)


def undistorted_view(view: View, focal_px: float) -> PinholeView:
    """The view at about this focal length, never enlarged."""
    camera, pixels = view.camera, view.photo.pixels_bgr
    height, width = pixels.shape[:2]
    scale = min(1.0, focal_px / camera.fy, MAX_SIDE_PX / max(height, width))
    factor = max(1, int(1.0 / scale))
    small = reduce_by(pixels, factor)
    # px of the reduced photograph: centres move by half a pixel
    middle = [(centre + 0.5) / factor - 0.5 for centre in (camera.cx, camera.cy)]
    matrix = np.array(
        [
            [camera.fx / factor, 0.0, middle[0]],
            [0.0, camera.fy / factor, middle[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    focal = camera.fy * scale
    size = (round(width * scale), round(height * scale))
    target = ((camera.cx + 0.5) * scale - 0.5, (camera.cy + 0.5) * scale - 0.5)
    pinhole = np.array([[focal, 0.0, target[0]], [0.0, focal, target[1]], [0.0, 0.0, 1.0]])
    maps = cv2.initUndistortRectifyMap(
        matrix, np.array(camera.distortion), np.eye(3), pinhole, size, cv2.CV_32FC1
    )
    picture = np.asarray(cv2.remap(small, *maps, cv2.INTER_LINEAR), np.uint8)
    return PinholeView(picture, float(focal), target, view.rotation, view.centre_mm)
