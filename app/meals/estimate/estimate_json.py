"""The pipeline's options and answer as JSON: to and from the child process, in the store, on the command line."""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Protocol

import numpy as np
from pydantic import TypeAdapter

from app.candidates.vcm_json import vcm_answer
from app.core.errors import Failure, InvalidInputError
from app.meals.stored.outline_json import rings_of
from app.meals.stored.run_answer import ItemAnswer, Json, RunAnswer
from app.nutrition.foods import FOOD_FORMS, SLICE_FORMS
from app.nutrition.usual_form import FOOD_HEIGHTS
from app.photos.slots import VIEW_SLOTS
from app.vision.intrinsics import camera_from_mapping, camera_to_json
from app.vision.known_object import KnownObject, parse_scale
from app.vision.known_poses import poses_from_mapping, poses_to_json
from app.vision.model import (
    ColourCorrection,
    EstimateOptions,
    Hint,
    ItemEstimate,
    ItemTraits,
    MealEstimate,
)
from app.vision.rig import rig_from_mapping, rig_to_json
from app.vision.vessel_library import vessel_to_json, vessels_from_json

MATRIX_DECIMALS = 5
HINT = TypeAdapter(Hint)


class FormedFood(Protocol):
    """What a food table says of a food's form; see Hint."""

    @property
    def form(self) -> str:
        """How it usually lies."""

    @property
    def slice_form(self) -> str | None:
        """How its slices are fitted by the paper's method."""


def options_to_json(options: EstimateOptions) -> dict[str, object]:
    """EstimateOptions as JSON."""
    return {
        "marker": options.marker_text,
        "camera": camera_to_json(options.camera) if options.camera is not None else None,
        "rig": rig_to_json(options.rig) if options.rig is not None else None,
        "poses": poses_to_json(options.poses) if options.poses is not None else None,
        "method": options.method,
        "hints": [hint_to_json(hint) for hint in options.hints],
        "complete": options.is_complete,
        "vessels": [vessel_to_json(vessel) for vessel in options.vessels],
        "seed": options.seed,
    }


def options_from_json(value: Mapping[str, Any]) -> EstimateOptions:
    """The reverse of options_to_json.

    Raises InvalidInputError for a marker, camera, rig or poses that cannot be, and if none of them
    gives the scale.
    """
    if not value.get("depth") and all(value.get(key) is None for key in ("marker", "rig", "poses")):
        raise InvalidInputError(
            "Neither a marker nor a rig gives the scale: name one.", code="marker_missing"
        )
    return replace(
        scale_by(value.get("marker")),
        camera=camera_from_mapping(value["camera"]) if value.get("camera") is not None else None,
        rig=rig_from_mapping(value["rig"]) if value.get("rig") is not None else None,
        poses=poses_from_mapping(value["poses"]) if value.get("poses") is not None else None,
        method=value.get("method", "shape"),
        hints=tuple(hint_from_json(hint) for hint in value.get("hints", ())),
        is_complete=bool(value.get("complete", False)),
        vessels=vessels_from_json(value.get("vessels", [])),
        seed=int(value.get("seed", 0)),
    )


def scale_by(marker: str | None) -> EstimateOptions:
    """Return options with the board or coin that a text announces. Raises InvalidInputError."""
    scale = parse_scale(marker) if marker is not None else None
    if isinstance(scale, KnownObject):
        return EstimateOptions(None, known=scale)
    return EstimateOptions(scale)


def hint_to_json(hint: Hint) -> Json:
    """A hint without its empty fields."""
    return {name: value for name, value in asdict(hint).items() if value is not None}


def hint_from_json(value: Mapping[str, Any]) -> Hint:
    """The reverse of hint_to_json; an outline may also be one ring.

    Raises ValueError, TypeError.
    """
    polygon = value.get("polygon")
    return HINT.validate_python(
        {**value, "polygon": rings_of(polygon) if polygon is not None else None}
    )


def answer_of(estimate: MealEstimate, options: EstimateOptions) -> RunAnswer:
    """A MealEstimate without its artefacts."""
    views, colours = estimate.views, estimate.colours
    second = VIEW_SLOTS[estimate.second_place]
    return RunAnswer(
        items=[_item(item) for item in estimate.items],
        failure=estimate.failure,
        marker=options.marker_text,
        camera=camera_to_json(views[0].camera) if views is not None else None,
        camera_right=camera_to_json(views[1].camera)
        if views is not None and views[1] is not None
        else None,
        colour={"left": colour_to_json(colours[0]), second: colour_to_json(colours[1])}
        if colours
        else None,
        second=second,
        stages={name: round(seconds, 4) for name, seconds in estimate.stages.items()},
        seconds=round(sum(estimate.stages.values()), 4),
        method=estimate.method,
        pipeline_version=estimate.pipeline_version,
        parameters=json.loads(json.dumps(dict(estimate.parameters))),  # tuples become lists
    )


def colour_to_json(colour: ColourCorrection) -> Json:
    """A photograph's colour correction."""
    return {
        "kind": colour.kind,
        "matrix": np.round(colour.matrix, MATRIX_DECIMALS).tolist(),
        "delta_e_mean": round(colour.delta_e_mean, 2) if colour.delta_e_mean is not None else None,
        "delta_e_worst": round(colour.delta_e_worst, 2)
        if colour.delta_e_worst is not None
        else None,
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


def failure_to_json(failure: Failure) -> Json:
    """A failure as JSON."""
    return {"code": failure.code, "message": failure.message, "advice": failure.advice}


def with_forms(options: EstimateOptions, foods: Mapping[str, FormedFood]) -> EstimateOptions:
    """Options whose hints know how their food usually lies and how its slices are fitted.

    foods: by key.
    """
    return replace(
        options, hints=tuple(_with_form(hint, foods.get(hint.food or "")) for hint in options.hints)
    )


def _with_form(hint: Hint, food: FormedFood | None) -> Hint:
    if food is None:
        return hint
    usual_form = next((form for form in FOOD_FORMS if form == food.form), None)
    slice_form = next((form for form in SLICE_FORMS if form == food.slice_form), None)
    return replace(
        hint,
        usual_form=usual_form,
        usual_height=FOOD_HEIGHTS.get(hint.food or ""),
        slice_form=slice_form,
    )


def _item(item: ItemEstimate) -> ItemAnswer:
    rings = [ring.tolist() for ring in item.rings]
    volume_ml, interval_ml = item.volume_ml, item.volume_interval_ml
    return ItemAnswer(
        polygon=rings[0] if len(rings) == 1 else rings,
        volume_ml=round(volume_ml, 3) if volume_ml is not None else None,
        volume_interval_ml=[round(bound, 3) for bound in interval_ml]
        if interval_ml is not None
        else None,
        relative_sd={part: round(sd, 5) for part, sd in item.relative_sd.items()},
        candidates=[],
        hint=item.hint,
        flags=list(item.flags),
        traits=_traits(item.traits),
        vcm=vcm_answer(item.vcm) if item.vcm is not None else None,
    )


def _traits(traits: ItemTraits) -> Json:
    return {
        "centre_mm": [round(each, 1) for each in traits.centre_mm]
        if traits.centre_mm is not None
        else None,
        "radius_mm": round(traits.radius_mm, 1) if traits.radius_mm is not None else None,
        "lab": [round(each, 1) for each in traits.lab] if traits.lab is not None else None,
    }
