"""`tada estimate`: one or more files in, the answer as JSON out, foods of hints resolved in the starter table."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from app.candidates.identify_photo import identify_items
from app.core.errors import InvalidInputError
from app.foods.food_amounts import amounts_of
from app.meals.estimate.estimate_json import hint_from_json, options_from_json, with_forms
from app.meals.estimate.run_estimate import DepthFiles, run_estimate
from app.nutrition.foods import FOOD_FORMS, load_starter_table
from app.photos.slots import PAIR_SLOTS, VIEW_SLOTS
from app.vision.marker_spec import DEFAULT_MARKER
from app.vision.model import EstimateOptions, Method
from app.vision.photograph.depth_camera import depth_camera_from_mapping

PAIR, MAX_VIEWS = len(PAIR_SLOTS), len(VIEW_SLOTS)
HINT_KEYS = frozenset({"point", "box", "polygon", "food", "lies_as", "form", "vessel"})


def read_options(
    *,
    marker: str | None,
    camera: Path | None,
    rig: Path | None = None,
    poses: Path | None = None,
    method: str,
    hints: Sequence[str],
    is_complete: bool = False,
    vessels: Path | None = None,
    has_depth: bool = False,
) -> EstimateOptions:
    """Options from the command line's words. Raises InvalidInputError with a sentence."""
    if method not in get_args(Method):
        raise InvalidInputError(
            f"There is no method {method!r}; there is {', '.join(get_args(Method))}."
        )
    if rig is not None and (marker is not None or camera is not None):
        raise InvalidInputError(
            "--rig has its own cameras and scale: leave --marker and --camera out."
        )
    if rig is not None and method == "paper-strict":
        raise InvalidInputError(
            "The method paper-strict needs a marker for its tie points: measure a rig by another one."
        )
    if poses is not None and (camera is None or rig is not None or method == "paper-strict"):
        raise InvalidInputError(
            "--poses needs --camera and takes the place of --rig; paper-strict needs a marker."
        )
    is_marker_usual = marker is None and rig is None and poses is None and not has_depth
    value = {
        "marker": DEFAULT_MARKER if is_marker_usual else marker,
        "camera": _read_object(_text_of(camera), str(camera)) if camera is not None else None,
        "rig": _read_object(_text_of(rig), str(rig)) if rig is not None else None,
        "poses": _read_object(_text_of(poses), str(poses)) if poses is not None else None,
        "method": method,
        "depth": has_depth,
        "hints": [_read_hint(hint) for hint in hints],
        "complete": is_complete,
        "vessels": _parsed(_text_of(vessels), str(vessels)) if vessels is not None else [],
    }
    return options_from_json(value)


def estimate_files(
    photographs: Sequence[Path],
    options: EstimateOptions,
    *,
    max_pixels: int,
    debug: Path | None,
    on_stage: Callable[[str], None] | None,
    index: Path | None = None,
    depths: Sequence[str] = (),
    depth_camera: Path | None = None,
    confidences: Sequence[str] = (),
) -> dict[str, Any]:
    """Run the pipeline on one to eight files; with `debug`, write its pictures there.

    index: None: the shipped one.
    """
    _require_number(len(photographs), options)
    names = VIEW_SLOTS[: len(photographs)]
    depth_files = _read_depths(
        depths, depth_camera, confidences, dict(zip(names, photographs, strict=True))
    )
    if depth_files:
        _require_scale(depth_files, options)
    table = {food.key: food for food in load_starter_table().foods}
    require_foods(options)
    options = with_forms(options, table)
    try:
        found, estimate = run_estimate(
            dict(zip(names, photographs, strict=True)),
            options,
            max_pixels=max_pixels,
            on_stage=on_stage or (lambda _: None),
            want_artefacts=debug is not None,
            depths=depth_files,
            index=index,
        )
    except OSError as error:
        raise InvalidInputError(f"{error.filename} cannot be read: {error.strerror}.") from None
    if debug is not None and estimate is not None:
        debug.mkdir(parents=True, exist_ok=True)
        for artefact in estimate.artefacts:
            (debug / artefact.name).write_bytes(artefact.content)
    answer: dict[str, Any] = found.as_json()
    identify_items(answer["items"], index)
    for item in answer["items"]:
        hint = options.hints[item["hint"]] if item["hint"] is not None else None
        food = table[hint.food] if hint is not None and hint.food else None
        item.update(amounts_of(item, food, hint.lies_as if hint is not None else None))
    return answer


def require_foods(options: EstimateOptions) -> None:
    """Raise InvalidInputError if the starter table lacks a food of the hints."""
    keys = {food.key for food in load_starter_table().foods}
    unknown = sorted({hint.food for hint in options.hints if hint.food} - keys)
    if unknown:
        raise InvalidInputError(
            f"The food table has no {', '.join(unknown)}: see `tada foods search`."
        )


def _require_number(count: int, options: EstimateOptions) -> None:
    if count > MAX_VIEWS:
        raise InvalidInputError(
            f"{count} photographs were given; of one meal {MAX_VIEWS} are the most."
        )
    needs_pair = options.rig is not None or (options.poses is not None and options.marker is None)
    if needs_pair or options.method != "shape":
        hint = "give both" if count < PAIR else "leave the others out"
        if count != PAIR:
            raise InvalidInputError(
                f"A rig, poses and the methods of the paper measure by two photographs: {hint}."
            )


def _require_scale(depths: Mapping[str, object], options: EstimateOptions) -> None:
    """Raise InvalidInputError if neither a marker, a rig nor the first photograph's depth map gives the scale."""
    has_scale = any(each is not None for each in (options.marker, options.rig, options.poses))
    if not has_scale and ("left" not in depths or options.method != "shape"):
        raise InvalidInputError(
            "Without --marker the depth map of the first photograph gives the scale, by the method shape: give "
            "--depth left=FILE, or the marker."
        )


def _read_depths(
    depths: Sequence[str],
    camera: Path | None,
    confidences: Sequence[str],
    photographs: Mapping[str, Path],
) -> dict[str, DepthFiles]:
    """Depth maps by the name of their photograph, left, right, view3 ..., with their confidence maps."""
    maps = _files_by_view("--depth", depths, photographs)
    confidence_maps = _files_by_view("--depth-confidence", confidences, photographs)
    if not confidence_maps.keys() <= maps.keys():
        raise InvalidInputError("--depth-confidence needs --depth of the same photograph.")
    if not maps:
        return {}
    if camera is None:
        raise InvalidInputError("--depth needs --depth-camera FILE.", code="depth_camera_invalid")
    intrinsics = _read_object(_text_of(camera), str(camera))
    depth_camera_from_mapping(intrinsics)
    return {
        view: DepthFiles(path, intrinsics, confidence_maps.get(view)) for view, path in maps.items()
    }


def _files_by_view(
    option: str, texts: Sequence[str], photographs: Mapping[str, Path]
) -> dict[str, Path]:
    """Files given as VIEW=FILE.

    VIEW: a photograph's name, or its file's name without the ending.
    """
    files = {}
    for text in texts:
        view, _, file = text.partition("=")
        names = [name for name, path in photographs.items() if view in (name, path.stem)]
        if not file or not names:
            raise InvalidInputError(
                f"{option} {text}: VIEW=FILE, VIEW being one of the photographs."
            )
        files[names[0]] = Path(file)
    return files


def _read_hint(text: str) -> dict[str, Any]:
    value = _read_object(text, "--hint")
    unknown = set(value) - HINT_KEYS
    if unknown:
        raise InvalidInputError(
            f"--hint has unknown keys {sorted(unknown)}; known are {sorted(HINT_KEYS)}."
        )
    for key in ("lies_as", "form"):
        if value.get(key) not in (None, *FOOD_FORMS):
            raise InvalidInputError(
                f"--hint: {key} is one of {', '.join(FOOD_FORMS)}, not {value[key]!r}."
            )
    try:
        hint_from_json(value)
    except (TypeError, ValueError):
        raise InvalidInputError(
            f"--hint {text} does not fit: see `tada estimate --help`."
        ) from None
    return value


def _text_of(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise InvalidInputError(f"{path} is not a text file in UTF-8.") from None


def _parsed(text: str, source: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidInputError(f"{source} is not JSON: {error}.") from None


def _read_object(text: str, source: str) -> dict[str, Any]:
    value = _parsed(text, source)
    if not isinstance(value, dict):
        raise InvalidInputError(f"{source} must be a JSON object.")
    return value
