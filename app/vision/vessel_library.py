"""A study's vessels, measured once: what a mug or bowl of the library holds at each level.

JSON of the library in -> VesselModel. Apart from what finds vessels in photographs, so that the API, which keeps the
library, needs neither NumPy nor OpenCV.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal, get_args

from app.core.errors import InvalidInputError

VesselKind = Literal[
    "mug", "cup", "glass", "tall_glass", "bowl", "soup_bowl", "deep_plate", "other"
]

# listed beside vessels by some; nothing has a level in them
FLAT_KINDS = ("plate", "big_plate", "board")
VESSEL_KINDS: tuple[VesselKind, ...] = get_args(VesselKind)
MAX_VESSELS = 500
MAX_PROFILE_POINTS = 200
RIM_DIAMETER_MM = (20.0, 500.0)
HEIGHT_MM = (5.0, 400.0)
CAPACITY_ML = (5.0, 20_000.0)


@dataclass(frozen=True, slots=True)
class VesselModel:
    """One vessel of a study's library.

    rim_diameter_mm: inside, at the brim. height_mm: of the brim over the table. capacity_ml: filled to the brim; None
    if it was not measured. inside_profile_mm: (radius, height over the table), from the middle of the floor up to the
    brim; empty if it was not measured: then the inside is a frustum that holds capacity_ml.
    """

    name: str
    kind: VesselKind
    rim_diameter_mm: float
    height_mm: float
    capacity_ml: float | None = None
    inside_profile_mm: tuple[tuple[float, float], ...] = ()


def vessels_from_json(value: object) -> tuple[VesselModel, ...]:
    """The library from a parsed JSON list; FLAT_KINDS are passed over. Raises InvalidInputError, "vessel_invalid"."""
    if not isinstance(value, list) or len(value) > MAX_VESSELS:
        raise _invalid(f"it must be a list of at most {MAX_VESSELS} objects.")
    vessels = tuple(
        vessel_from_mapping(entry)
        for entry in value
        if not (isinstance(entry, Mapping) and entry.get("kind") in FLAT_KINDS)
    )
    names = [vessel.name for vessel in vessels]
    if len(set(names)) < len(names):
        raise _invalid("two vessels have the same name.")
    return vessels


def vessel_from_mapping(data: object) -> VesselModel:
    """A VesselModel from its JSON object; other keys are ignored. Raises InvalidInputError, code "vessel_invalid"."""
    if not isinstance(data, Mapping):
        raise _invalid(
            "each vessel must be an object with name, kind, rim_diameter_mm and height_mm."
        )
    name = data.get("name")
    kind = next((kind for kind in VESSEL_KINDS if kind == data.get("kind")), None)
    if not isinstance(name, str) or not 1 <= len(name) <= 100:
        raise _invalid("name must be a text of 1 to 100 characters.")
    if kind is None:
        raise _invalid(f"kind must be one of {', '.join(VESSEL_KINDS)}.")
    capacity = data.get("capacity_ml")
    model = VesselModel(
        name=name,
        kind=kind,
        rim_diameter_mm=_number(data.get("rim_diameter_mm"), "rim_diameter_mm", RIM_DIAMETER_MM),
        height_mm=_number(data.get("height_mm"), "height_mm", HEIGHT_MM),
        capacity_ml=_number(capacity, "capacity_ml", CAPACITY_ML) if capacity is not None else None,
        inside_profile_mm=_profile(data.get("inside_profile_mm") or ()),
    )
    if model.capacity_ml is None and not model.inside_profile_mm:
        raise _invalid(
            "give capacity_ml or inside_profile_mm: without either the level says nothing of the volume."
        )
    return model


def vessel_to_json(model: VesselModel) -> dict[str, object]:
    """The reverse of vessel_from_mapping."""
    return asdict(model) | {"inside_profile_mm": [list(point) for point in model.inside_profile_mm]}


def _profile(value: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) > MAX_PROFILE_POINTS:
        raise _invalid(
            f"inside_profile_mm must be a list of at most {MAX_PROFILE_POINTS} pairs [radius, height]."
        )
    points = []
    for pair in value:
        if not isinstance(pair, Sequence) or len(pair) != 2:
            raise _invalid("inside_profile_mm must be a list of pairs [radius, height].")
        radius, height = (_number(each, "inside_profile_mm", (0.0, HEIGHT_MM[1])) for each in pair)
        points.append((radius, height))
    heights = [height for _, height in points]
    if points and (heights != sorted(heights) or heights[0] == heights[-1]):
        raise _invalid("inside_profile_mm must rise from the floor to the brim.")
    return tuple(points)


def _number(value: object, name: str, limits: tuple[float, float]) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _invalid(f"{name} must be a number.")
    if not limits[0] <= value <= limits[1]:
        raise _invalid(f"{name} must be from {limits[0]:g} to {limits[1]:g}, not {value:g}.")
    return float(value)


def _invalid(reason: str) -> InvalidInputError:
    return InvalidInputError(f"This is no vessel library: {reason}", code="vessel_invalid")
