"""A vessel's measures as they come in, from the API, a form or a file: checked, and turned into a VesselModel."""

import math
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace

from app.core.errors import InvalidInputError
from app.vision.vessel_frustum import capacity_from_fill_line, profile_capacity_ml
from app.vision.vessel_library import VesselModel, vessel_from_mapping

NAME_LENGTH = 100
# a deep plate with a broad rim holds a fifth of the cylinder over its brim
MIN_SHARE_OF_CYLINDER = 0.05
MAX_SHARE_OF_CYLINDER = 4.0  # a belly of twice the rim's width
MAX_CAPACITY_RATIO = 1.5  # of capacity and profile: a ruler's profile is good to a tenth or two


@dataclass(frozen=True, slots=True)
class MeasuredVessel:
    """A vessel as it was measured.

    model: with the capacity that follows from the fill line where none was measured.

    fill_line_mm: a mark's height over the table; fill_line_ml: what the vessel holds up to it; both
    or none.
    """

    model: VesselModel
    capacity_ml: float | None
    fill_line_mm: float | None = None
    fill_line_ml: float | None = None

    def columns(self) -> dict[str, object]:
        """As a version keeps it."""
        return {
            **{
                name: getattr(self.model, name) for name in ("kind", "rim_diameter_mm", "height_mm")
            },
            **{
                name: getattr(self, name)
                for name in ("capacity_ml", "fill_line_mm", "fill_line_ml")
            },
            "inside_profile_mm": [list(point) for point in self.model.inside_profile_mm],
        }


def measured_vessel(data: object) -> MeasuredVessel:
    """A vessel from its JSON object: vessel_library's keys, and fill_line_mm with fill_line_ml.

    Raises InvalidInputError: `vessel_invalid`; `vessel_impossible` where the measures contradict
    each other.
    """
    if not isinstance(data, Mapping):
        return MeasuredVessel(vessel_from_mapping(data), None)  # refuses it
    fields = {**data, "name": vessel_name(data.get("name"))}
    fill_line = _fill_line(fields)
    if (
        fill_line is None
        and fields.get("capacity_ml") is None
        and not fields.get("inside_profile_mm")
    ):
        raise InvalidInputError(
            "Give the vessel's capacity, a fill line or its inside profile: without any the level says nothing of the "
            "volume.",
            code="vessel_invalid",
        )
    if fill_line is None:
        model = vessel_from_mapping(fields)
        _require_possible(model)
        return MeasuredVessel(model, model.capacity_ml)
    measured_ml = fields.get("capacity_ml")
    fill_line_mm, fill_line_ml = fill_line
    capacity_ml = measured_ml if measured_ml is not None else fill_line_ml
    outline = vessel_from_mapping({**fields, "capacity_ml": capacity_ml})
    outline = replace(outline, capacity_ml=outline.capacity_ml if measured_ml is not None else None)
    if fill_line_mm > outline.height_mm or fill_line_ml > capacity_ml:
        raise InvalidInputError(
            "A fill line is below the brim, and holds less than the brim.", code="vessel_impossible"
        )
    model = replace(outline, capacity_ml=known_capacity_ml(outline, *fill_line))
    _require_possible(model)
    return MeasuredVessel(model, outline.capacity_ml, *fill_line)


def known_capacity_ml(
    model: VesselModel, fill_line_mm: float | None, fill_line_ml: float | None
) -> float | None:
    """The measured capacity, else what follows from the fill line; None where the profile alone says it."""
    if (
        model.capacity_ml is not None
        or fill_line_mm is None
        or fill_line_ml is None
        or model.inside_profile_mm
    ):
        return model.capacity_ml
    return capacity_from_fill_line(
        rim_diameter_mm=model.rim_diameter_mm,
        height_mm=model.height_mm,
        fill_line_mm=fill_line_mm,
        fill_line_ml=fill_line_ml,
    )


def vessel_name(name: object) -> str:
    """A name as it is kept: blanks folded.

    Raises InvalidInputError `vessel_invalid` for what cannot be read.
    """
    cleaned = " ".join(unicodedata.normalize("NFC", name).split()) if isinstance(name, str) else ""
    if not 0 < len(cleaned) <= NAME_LENGTH or not cleaned.isprintable():
        raise InvalidInputError(
            f"A vessel's name must be a text of 1 to {NAME_LENGTH} printable characters.",
            code="vessel_invalid",
        )
    return cleaned


def name_key(name: str) -> str:
    """A name as it is compared: without case, blanks folded."""
    return " ".join(unicodedata.normalize("NFC", name).casefold().split())


def _fill_line(fields: Mapping[str, object]) -> tuple[float, float] | None:
    height_mm, volume_ml = fields.get("fill_line_mm"), fields.get("fill_line_ml")
    if height_mm is None and volume_ml is None:
        return None
    numbers = [
        float(value)
        for value in (height_mm, volume_ml)
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
    ]
    if len(numbers) < 2:
        raise InvalidInputError(
            "A fill line is given by both fill_line_mm, its height over the table, and fill_line_ml, what the "
            "vessel holds up to it: two numbers above 0.",
            code="vessel_invalid",
        )
    return numbers[0], numbers[1]


def _require_possible(model: VesselModel) -> None:
    """Refuse a radius for a diameter, centimetres for millimetres.

    Raises InvalidInputError `vessel_impossible`.
    """
    rim_radius_mm = model.rim_diameter_mm / 2
    if model.capacity_ml is not None:
        cylinder_ml = math.pi * rim_radius_mm**2 * model.height_mm / 1000.0
        if not MIN_SHARE_OF_CYLINDER <= model.capacity_ml / cylinder_ml <= MAX_SHARE_OF_CYLINDER:
            raise InvalidInputError(
                f"No vessel of this rim and height holds {model.capacity_ml:.0f} ml: as a cylinder it would hold "
                f"{cylinder_ml:.0f} ml. Are the lengths in mm, the rim a diameter, the capacity in ml?",
                code="vessel_impossible",
            )
    if model.inside_profile_mm:
        top_radius_mm, top_mm = model.inside_profile_mm[-1]
        if not (_agrees(top_radius_mm, rim_radius_mm) and _agrees(top_mm, model.height_mm)):
            raise InvalidInputError(
                f"The inside profile ends at radius {top_radius_mm:g} mm and height {top_mm:g} mm, and the brim is at "
                f"{rim_radius_mm:g} and {model.height_mm:g} mm: the last point must be the brim.",
                code="vessel_impossible",
            )
        held_ml = profile_capacity_ml(model.inside_profile_mm)
        if (
            model.capacity_ml is not None
            and not 1 / MAX_CAPACITY_RATIO < held_ml / model.capacity_ml < MAX_CAPACITY_RATIO
        ):
            raise InvalidInputError(
                f"The inside profile holds {held_ml:.0f} ml, and the capacity is {model.capacity_ml:.0f} ml: measure "
                "one of them again, or leave one out.",
                code="vessel_impossible",
            )


def _agrees(value_mm: float, measured_mm: float) -> bool:
    """Within a tenth: a rounded lip has no sharp brim, and another unit or a diameter is off by twice and more."""
    return abs(value_mm - measured_mm) <= 0.1 * measured_mm
