"""The reduced grid on which foods are looked for: the picture, heights over the table, and their windows."""

from dataclasses import dataclass

import numpy as np

from app.vision.geometry.pictures import scaled_and_shifted
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.scene.plane_sweep import PlaneSweep

# of the scene's grid: a window's reach up to which a height is that of its pixel
FINE_REACH_PX = 2.5
# correlation at the table's plane: foods 8 mm high and more reach 0.55, the table 0.9
IS_TABLE = 0.7


@dataclass(frozen=True, slots=True)
class Scene:
    """What is known of each pixel of a reduced grid, (h, w) each, before food is told from the rest.

    image_bgr: (h, w, 3). height_mm: over the table, NaN where unmeasured. points_table: (h, w, 3). reach_px: of the
    window behind each height, in pixels of this grid. is_ignored: sheet, unseen. plane_xy_mm: (h, w, 2) where the
    pixel's ray meets z = 0. camera_mm: (3,). pixel_mm: what a pixel spans on the table. texture: fine
    contrast, grey levels. table_correlation: of both views if the pixel shows the table's plane, NaN where it is plain.
    sweep: of both views; None for a single one.
    """

    image_bgr: ImageArray
    height_mm: Float32Array
    points_table: Float32Array
    reach_px: Float32Array
    is_ignored: MaskArray
    plane_xy_mm: Float32Array
    camera_mm: Float64Array
    pixel_mm: float
    texture: Float32Array
    table_correlation: Float32Array
    sweep: PlaneSweep | None = None

    def xy_at(
        self, height_mm: float, window: tuple[slice, slice] = (slice(None), slice(None))
    ) -> Float32Array:
        """Return where each pixel's ray meets the plane of this height, (h, w, 2) mm. window: rows, columns."""
        share = (self.camera_mm[2] - height_mm) / self.camera_mm[2]
        return scaled_and_shifted(
            self.plane_xy_mm[window], share, (1.0 - share) * self.camera_mm[:2]
        )

    def distance_mm(self, window: tuple[slice, slice] = (slice(None), slice(None))) -> Float32Array:
        """(h, w) from the camera to what a pixel shows; NaN where unmeasured. window: rows, columns."""
        return np.asarray(
            np.linalg.norm(self.points_table[window] - self.camera_mm, axis=-1), np.float32
        )


def commonest(heights_mm: Float32Array, span_mm: float) -> float:
    """The median of the values within the span that holds most of them."""
    ordered = np.sort(heights_mm)
    end = np.searchsorted(ordered, ordered + span_mm)
    start = int(np.argmax(end - np.arange(len(ordered))))
    return float(np.median(ordered[start : end[start]]))
