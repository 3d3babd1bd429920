"""The side view of a vessel as numbers for an SVG: the measured inside profile, or the frustum of the same capacity."""

from dataclasses import dataclass

from app.vision.vessel_frustum import frustum_floor_mm
from app.vision.vessel_library import VesselModel

MARGIN_MM = 4.0


@dataclass(frozen=True, slots=True)
class VesselDrawing:
    """Millimetres, x to the right from the vessel's left edge, y downwards.

    points: of an SVG polyline. is_measured: the profile was measured, not derived from the capacity. line_y: the fill
    line's, if there is one.
    """

    width_mm: float
    height_mm: float
    points: str
    is_measured: bool
    line_y: float | None


def vessel_drawing(model: VesselModel, fill_line_mm: float | None = None) -> VesselDrawing | None:
    """Return the side view; None if no frustum holds as little as the capacity, such as of a plate with a broad rim."""
    profile = model.inside_profile_mm or _frustum(model)
    if profile is None:
        return None
    widest_mm = max(radius for radius, _ in profile)
    top_mm = max(height for _, height in profile)
    middle_mm = widest_mm + MARGIN_MM
    right = [(middle_mm + radius, MARGIN_MM + top_mm - height) for radius, height in profile]
    left = [(2 * middle_mm - x, y) for x, y in reversed(right)]
    return VesselDrawing(
        width_mm=2 * middle_mm,
        height_mm=top_mm + 2 * MARGIN_MM,
        points=" ".join(f"{x:.1f},{y:.1f}" for x, y in (*left, *right)),
        is_measured=bool(model.inside_profile_mm),
        line_y=MARGIN_MM + top_mm - fill_line_mm if fill_line_mm is not None else None,
    )


def _frustum(model: VesselModel) -> tuple[tuple[float, float], ...] | None:
    if model.capacity_ml is None:
        return None
    floor_mm = frustum_floor_mm(
        rim_diameter_mm=model.rim_diameter_mm,
        height_mm=model.height_mm,
        level_mm=model.height_mm,
        volume_ml=model.capacity_ml,
    )
    return (
        ((floor_mm, 0.0), (model.rim_diameter_mm / 2, model.height_mm))
        if floor_mm is not None
        else None
    )
