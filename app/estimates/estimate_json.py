"""The pipeline's options and answer as JSON: to and from the child process, in the store, on the command line."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from app.candidates.vcm_json import vcm_to_json
from app.core.errors import Failure
from app.estimates.camera_json import camera_to_json
from app.records.outline_json import rings_of
from app.vision.intrinsics import camera_from_mapping
from app.vision.marker_spec import parse_marker
from app.vision.model import ColourCorrection, EstimateOptions, Hint, ItemEstimate, ItemTraits, MealEstimate
from app.vision.vessel_library import vessel_to_json, vessels_from_json

MATRIX_DECIMALS = 5


class FormsOfFood(NamedTuple):
    """What the food table says of a food's form; see Hint."""

    usual_form: Any
    slice_form: Any


def options_to_json(options: EstimateOptions) -> dict[str, Any]:
    """EstimateOptions as JSON."""
    return {
        "marker": str(options.marker),
        "camera": camera_to_json(options.camera) if options.camera is not None else None,
        "method": options.method,
        "hints": [hint_to_json(hint) for hint in options.hints],
        "complete": options.is_complete,
        "vessels": [vessel_to_json(vessel) for vessel in options.vessels],
        "seed": options.seed,
    }


def options_from_json(value: Mapping[str, Any]) -> EstimateOptions:
    """The reverse of options_to_json. Raises InvalidInputError for a marker or camera that cannot be."""
    return EstimateOptions(
        marker=parse_marker(value["marker"]),
        camera=camera_from_mapping(value["camera"]) if value.get("camera") is not None else None,
        method=value.get("method", "shape"),
        hints=tuple(hint_from_json(hint) for hint in value.get("hints", ())),
        is_complete=bool(value.get("complete", False)),
        vessels=vessels_from_json(value.get("vessels", [])),
        seed=int(value.get("seed", 0)),
    )


def hint_to_json(hint: Hint) -> dict[str, Any]:
    """A hint without its empty fields."""
    fields: dict[str, Any] = {
        "point": hint.point,
        "box": hint.box,
        "polygon": hint.polygon,
        "food": hint.food,
        "lies_as": hint.lies_as,
        "form": hint.form,
        "usual_form": hint.usual_form,
        "vessel": hint.vessel,
        "slice_form": hint.slice_form,
    }
    return {name: value for name, value in fields.items() if value is not None}


def hint_from_json(value: Mapping[str, Any]) -> Hint:
    """The reverse of hint_to_json; lists become tuples."""
    return Hint(
        point=_tuple(value.get("point")),
        box=_tuple(value.get("box")),
        polygon=_polygon(value["polygon"]) if value.get("polygon") is not None else None,
        food=value.get("food"),
        lies_as=value.get("lies_as"),
        form=value.get("form"),
        usual_form=value.get("usual_form"),
        vessel=value.get("vessel"),
        slice_form=value.get("slice_form"),
    )


def estimate_to_json(estimate: MealEstimate, options: EstimateOptions) -> dict[str, Any]:
    """A MealEstimate as JSON, without its artefacts. Keys: see docs/cli.md, `tada estimate --json`."""
    failure, views, colours = estimate.failure, estimate.views, estimate.colours
    return {
        "items": [_item(item) for item in estimate.items],
        "failure": failure_to_json(failure) if failure is not None else None,
        "marker": str(options.marker),
        "camera": camera_to_json(views[0].camera) if views is not None else None,
        "camera_right": camera_to_json(views[1].camera) if views is not None else None,
        "colour": {"left": colour_to_json(colours[0]), "right": colour_to_json(colours[1])} if colours else None,
        "stages": {name: round(seconds, 4) for name, seconds in estimate.stages.items()},
        "seconds": round(sum(estimate.stages.values()), 4),
        "method": estimate.method,
        "pipeline_version": estimate.pipeline_version,
        "parameters": dict(estimate.parameters),
    }


def colour_to_json(colour: ColourCorrection) -> dict[str, Any]:
    """A photograph's colour correction."""
    return {
        "kind": colour.kind,
        "matrix": np.round(colour.matrix, MATRIX_DECIMALS).tolist(),
        "delta_e_mean": round(colour.delta_e_mean, 2) if colour.delta_e_mean is not None else None,
        "delta_e_worst": round(colour.delta_e_worst, 2) if colour.delta_e_worst is not None else None,
        "flags": list(colour.flags),
    }


def colour_from_json(value: Mapping[str, Any]) -> ColourCorrection:
    """The reverse of colour_to_json."""
    return ColourCorrection(
        matrix=np.array(value["matrix"], np.float64),
        kind=value["kind"],
        delta_e_mean=value["delta_e_mean"],
        delta_e_worst=value["delta_e_worst"],
        flags=tuple(value["flags"]),
    )


def failure_to_json(failure: Failure) -> dict[str, str]:
    """A failure as JSON."""
    return {"code": failure.code, "message": failure.message, "advice": failure.advice}


def with_forms(options: EstimateOptions, forms: Mapping[str, FormsOfFood]) -> EstimateOptions:
    """Options whose hints know how their food usually lies and how its slices are fitted. forms: by the food's key."""
    known = [(hint, forms.get(hint.food) if hint.food else None) for hint in options.hints]
    hints = tuple(
        hint if of_food is None else replace(hint, usual_form=of_food.usual_form, slice_form=of_food.slice_form)
        for hint, of_food in known
    )
    return replace(options, hints=hints)


def _polygon(value: Sequence[Any]) -> tuple[tuple[tuple[float, float], ...], ...]:
    return tuple(tuple((float(x), float(y)) for x, y in ring) for ring in rings_of(value))


def _item(item: ItemEstimate) -> dict[str, Any]:
    rings = [ring.tolist() for ring in item.rings]
    volume_ml, interval_ml = item.volume_ml, item.volume_interval_ml
    return {
        "polygon": rings[0] if len(rings) == 1 else rings,
        "volume_ml": round(volume_ml, 3) if volume_ml is not None else None,
        "volume_interval_ml": [round(bound, 3) for bound in interval_ml] if interval_ml is not None else None,
        "relative_sd": {part: round(sd, 5) for part, sd in item.relative_sd.items()},
        "candidates": [],
        "hint": item.hint,
        "flags": list(item.flags),
        "traits": _traits(item.traits),
        "vcm": vcm_to_json(item.vcm) if item.vcm is not None else None,
    }


def _traits(traits: ItemTraits) -> dict[str, Any]:
    return {
        "centre_mm": [round(each, 1) for each in traits.centre_mm] if traits.centre_mm is not None else None,
        "radius_mm": round(traits.radius_mm, 1) if traits.radius_mm is not None else None,
        "lab": [round(each, 1) for each in traits.lab] if traits.lab is not None else None,
    }


def _tuple(value: Sequence[float] | None) -> Any:
    return tuple(float(number) for number in value) if value is not None else None
