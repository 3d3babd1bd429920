"""What the views show of one food: the evidence that a form is fitted to."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.solids.fields import OutlineField, ParallaxField, outline_field, parallax_field
from app.vision.solids.outline_snap import Outline
from app.vision.solids.side_view import SideView
from app.vision.solids.surface_match import WINDOW_PX, SurfaceParallax
from app.vision.tuning import TUNING
from app.vision.views.disparity import DisparityMap
from app.vision.views.pinhole_view import PinholeView
from app.vision.views.sight import Sight

PAIR = 2  # views; those beyond are the others


@dataclass(frozen=True)
class Seen:
    """What the views show of a food. mask: (H, W). inward_px: (H, W) distance to the mask's outline.

    outlines: in the first and the second view, then in the others. dense: from the whole pair, where no surface is
    known yet. surface: measured along a form that is near the food's. by_maps: the same by depth maps beside
    the pair. outline_sd_px: of the outlines. side: the food in a photograph from the side.
    """

    sight: Sight
    mask: MaskArray
    inward_px: Float32Array
    outlines: tuple[Outline | None, ...]
    dense: DisparityMap
    surface: SurfaceParallax | None = None
    others: tuple[PinholeView, ...] = ()
    by_maps: tuple[SurfaceParallax, ...] = ()
    outline_sd_px: float = TUNING.outline_sd_px
    side: SideView | None = None

    def pixels(self, points_table: Float64Array, view: int) -> Float64Array:
        """(n, 2) px of points (n, 3) mm in a view, numbered as outlines."""
        if view >= PAIR:
            return self.others[view - PAIR].project(points_table)
        return self.sight.in_view(*self.sight.project(points_table), view)

    def pixel_gradient(self, points_table: Float64Array, view: int) -> Float64Array:
        """(n, 2, 3) derivative of the pixel in a view by the point, px/mm."""
        if view < PAIR:
            return self.sight.pixel_gradient(points_table, view)
        return self.others[view - PAIR].pixel_gradient(points_table)

    def camera_mm(self, view: int) -> Float64Array:
        """(3,) centre of a view's camera."""
        if view < PAIR:
            return self.sight.cameras_mm[view]
        return self.others[view - PAIR].centre_mm

    @cached_property
    def outline_fields(self) -> tuple[OutlineField | None, ...]:
        """The outlines as fields."""
        return tuple(None if line is None else outline_field(line) for line in self.outlines)

    @cached_property
    def parallax_fields(self) -> tuple[ParallaxField, ...]:
        """What is measured of the food's parallax, by the pair and by each depth map."""
        fields = [self._by_pair if self.surface is None else self._along_surface(self.surface)]
        for surface in self.by_maps:
            is_known = np.isfinite(surface.parallax_px)
            fields.append(
                parallax_field(
                    surface.parallax_px,
                    surface.sd_px,
                    is_known,
                    float(WINDOW_PX**2),
                    surface.origin,
                )
            )
        return tuple(field for field in fields if field is not None)

    @cached_property
    def _is_dense(self) -> MaskArray:
        """(H, W) whether the whole pair's map is known, clear of the food's outline."""
        dense = self.dense
        return np.isfinite(dense.parallax_px) & (self.inward_px > dense.reach_px + 1)

    @property
    def _by_pair(self) -> ParallaxField | None:
        """Of the map of the whole grid, clear of the food's outline by the map's reach."""
        dense = self.dense
        is_known = self._is_dense
        if dense.error_area_px is None or dense.sd_px is None:
            sd = np.full(dense.parallax_px.shape, TUNING.dense_sd_px, np.float32)
            return parallax_field(dense.parallax_px, sd, is_known, TUNING.dense_area_px)
        sd = np.nan_to_num(dense.sd_px)
        return parallax_field(
            dense.parallax_px, sd, is_known, dense.error_area_px, is_measurement=True
        )

    def _along_surface(self, surface: SurfaceParallax) -> ParallaxField | None:
        left, top = surface.origin
        height, width = surface.parallax_px.shape
        inward = self.inward_px[top : top + height, left : left + width]
        is_known = np.isfinite(surface.parallax_px) & (inward > 1)
        sd = np.hypot(surface.sd_px, np.float32(TUNING.surface_sd_px))
        is_known &= np.nan_to_num(sd, nan=np.inf) < TUNING.max_sd_px
        either = self._is_dense.copy()
        either[top : top + height, left : left + width] |= is_known
        return parallax_field(
            surface.parallax_px,
            sd,
            is_known,
            float(WINDOW_PX**2),
            surface.origin,
            known_px=float(np.count_nonzero(either)),
        )
