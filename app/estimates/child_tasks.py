"""What the child process does: everything that decodes uploaded bytes. JSON in, JSON out, files by path."""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import overload

import cv2
import numpy as np
from pydantic import BaseModel, JsonValue

from app.candidates.classifier_file import read_model
from app.candidates.likely_forms import form_index_version, likely_forms
from app.candidates.vcm_json import vcm_answer
from app.core.errors import Failure
from app.estimates.camera_json import camera_to_json
from app.estimates.estimate_json import answer_of, colour_from_json, failure_to_json, options_from_json
from app.meals.run_answer import ArtefactAnswer, Json, RunAnswer
from app.meals.thumbnails import THUMBNAIL_PX, thumbnail_name
from app.photos.heic_depth import read_heic_depth
from app.photos.heif import read_heif_layout
from app.photos.inspect import HEIC, PhotoFacts, inspect_photo, sniff
from app.photos.slots import PAIR_SLOTS
from app.vision import precheck
from app.vision.board.calibration import calibrate
from app.vision.board.colour_correction import apply_colour, measure_colour
from app.vision.board.marker import find_marker
from app.vision.depth_camera import depth_camera_from_mapping
from app.vision.depth_map import read_confidence, read_depth
from app.vision.heic_depth import decode_heic_depth
from app.vision.intrinsics import camera_from_mapping
from app.vision.looks.food_model import NetworkInput, classify_region, load_network
from app.vision.looks.vcm import describe_rings
from app.vision.marker_spec import parse_marker
from app.vision.model import (
    Artefact,
    ColourCorrection,
    DepthMap,
    EstimateOptions,
    ImageArray,
    MealEstimate,
    Photo,
    PhotoPair,
)
from app.vision.photo import read_photo, read_reduced_photo, why_not_whole
from app.vision.pipeline import estimate_meal
from app.vision.version import PIPELINE_VERSION

StageListener = Callable[[str], None]
Arguments = Mapping[str, object]  # JSON, checked by each task

GREY = Photo(np.full((64, 64, 3), 128, np.uint8))  # what a network is tried on
GREY_RINGS = [[(8.0, 8.0), (56.0, 8.0), (56.0, 56.0), (8.0, 56.0)]]
PICTURE_QUALITY = 85  # of JPEG: no artefacts to be seen at a screen's size


class _PairRequest(BaseModel):
    """Paths of both photographs."""

    left: Path
    right: Path
    max_pixels: int


@dataclass(frozen=True, slots=True)
class DepthFiles:
    """A depth map, its camera (depth_map.py's keys), and what is known of its confidence."""

    depth: Path
    camera: Mapping[str, float]
    confidence: Path | None = None

    def read(self, *, is_landscape: bool | None = None) -> DepthMap | Failure:
        """The map. is_landscape: of its upright photograph; None: either way.

        Failures: see read_depth; depth_mismatch of a turned map. Raises OSError, InvalidInputError (the camera).
        """
        camera = depth_camera_from_mapping(self.camera)
        if (
            is_landscape is not None
            and camera.width != camera.height
            and (camera.width > camera.height) != is_landscape
        ):
            return Failure(
                "depth_mismatch",
                "The depth map and its upright photograph are turned by a quarter against each other.",
                "Turn the map and its intrinsics as the photograph is shown upright.",
            )
        confidence = self.confidence.read_bytes() if self.confidence is not None else None
        return read_depth(self.depth.read_bytes(), camera, confidence)


class _EstimateRequest(BaseModel):
    """photographs: paths by view, in the order of VIEW_SLOTS. depths: of some of them."""

    photographs: dict[str, Path]
    depths: dict[str, DepthFiles] = {}
    max_pixels: int
    output_dir: Path
    options: Json
    food_index: Path | None = None


class _CheckRequest(_PairRequest):
    marker: str
    camera: Json | None


class _WholeRequest(BaseModel):
    """depth_camera: the file is a depth map of it, or its confidence map."""

    photo: Path
    depth_camera: dict[str, float] | None = None
    is_confidence: bool = False


class _CalibrateRequest(BaseModel):
    photos: list[Path]
    marker: str
    max_pixels: int


class _PictureRequest(BaseModel):
    photo: Path
    output: Path
    width_px: int
    max_pixels: int
    colour: Json | None


class _RegionRequest(BaseModel):
    """rings: px. colour: what the run kept of the photograph's; None: it is measured by the marker, if there is one."""

    rings: list[list[tuple[float, float]]]
    colour: Json | None
    marker: str | None


class _ClassifyRequest(BaseModel):
    """regions: rings of each, px. network_input: of food_model.NetworkInput."""

    photo: Path
    max_pixels: int
    regions: list[list[list[tuple[float, float]]]]
    colour: Json | None
    model: Path
    sha256: str
    network_input: NetworkInput


class _DescribeRequest(BaseModel):
    photo: Path
    max_pixels: int
    regions: list[_RegionRequest]


def estimate_task(arguments: Arguments, on_stage: StageListener) -> Json:
    """Estimate a meal from its photographs; artefacts are written to output_dir and listed in the answer.

    options: estimate_json's.
    """
    request = _EstimateRequest.model_validate(arguments)
    options = options_from_json({**request.options, "depth": bool(request.depths)})
    answer, estimate = run_estimate(
        request.photographs,
        options,
        max_pixels=request.max_pixels,
        on_stage=on_stage,
        want_artefacts=True,
        depths=request.depths,
        is_depth_needed=options.marker is None and options.rig is None and options.poses is None,
        index=request.food_index,
    )
    answer.artefacts = []
    for artefact in estimate.artefacts if estimate is not None else ():
        (request.output_dir / artefact.name).write_bytes(artefact.content)
        answer.artefacts.append(
            ArtefactAnswer(
                name=artefact.name,
                media_type=artefact.media_type,
                bytes=len(artefact.content),
                sha256=hashlib.sha256(artefact.content).hexdigest(),
            )
        )
    return answer.as_json()


def run_estimate(
    photographs: Mapping[str, Path],
    options: EstimateOptions,
    *,
    max_pixels: int,
    on_stage: StageListener,
    want_artefacts: bool,
    depths: Mapping[str, DepthFiles] | None = None,
    is_depth_needed: bool = True,
    index: Path | None = None,
) -> tuple[RunAnswer, MealEstimate | None]:
    """Read the photographs and run the pipeline: the answer, and the estimate unless reading failed.

    photographs: by name, left, right, then others. depths: depth maps of some. is_depth_needed: otherwise a map that
    cannot be used is left out, with the flag depth_ignored: it is one more measurement. index: of foods, whose
    candidates tell a single view's forms; None: the shipped one.
    Raises OSError if a file cannot be read.
    """
    started = time.perf_counter()
    on_stage("read")
    read = _read_photographs(photographs, options, max_pixels, depths or {}, is_depth_needed=is_depth_needed)
    read_seconds = time.perf_counter() - started
    if isinstance(read, Failure):
        stages = {"read": read_seconds}
        return answer_of(MealEstimate(options.method, PIPELINE_VERSION, stages, failure=read), options), None
    photos, unused = read
    options = replace(options, forms_by_looks=partial(likely_forms, index=index))
    pair = PhotoPair(photos[0], photos[1] if len(photos) > 1 else None, tuple(photos[2:]))
    estimate = estimate_meal(pair, options, on_stage=on_stage, want_artefacts=want_artefacts)
    items = tuple(replace(item, flags=(*dict.fromkeys((*item.flags, *unused)),)) for item in estimate.items)
    estimate = replace(estimate, items=items)
    answer = answer_of(estimate, options)
    if answer.parameters.get("views") == 1:
        answer.parameters["form_index"] = form_index_version(index)
    answer.stages = {"read": round(read_seconds, 4), **answer.stages}
    answer.seconds = round(time.perf_counter() - started, 4)
    if want_artefacts:
        estimate = replace(estimate, artefacts=[*estimate.artefacts, *_thumbnails(photos[:2], estimate)])
    return answer, estimate


def _read_photographs(
    photographs: Mapping[str, Path],
    options: EstimateOptions,
    max_pixels: int,
    depths: Mapping[str, DepthFiles],
    *,
    is_depth_needed: bool,
) -> tuple[list[Photo], tuple[str, ...]] | Failure:
    """The photographs with their depth maps, and flags for maps that are left out. See run_estimate."""
    photos: list[Photo] = []
    unused: tuple[str, ...] = ()
    for side, path in photographs.items():
        data = path.read_bytes()
        photo = read_photo(data, max_pixels=max_pixels)
        if isinstance(photo, Failure):
            return Failure(photo.code, f"The {side} photograph: {photo.message}", photo.advice)
        depth: DepthMap | Failure | None = None
        if side in depths:
            height, width = photo.pixels_bgr.shape[:2]
            depth = depths[side].read(is_landscape=None if width == height else width > height)
            if isinstance(depth, Failure) and is_depth_needed:
                return depth
        elif options.method == "shape" and len(photographs) == 1:  # of two, the pair knows more
            depth = _depth_inside(data)
        if isinstance(depth, Failure):
            unused = ("depth_ignored",)
        else:
            photo = replace(photo, depth=depth)
        if options.poses is not None:  # they are of the picture as it is stored
            facts = inspect_photo(path)
            photo = replace(photo, orientation=facts.orientation if isinstance(facts, PhotoFacts) else 1)
        photos.append(photo)
    return photos, unused


def _depth_inside(data: bytes) -> DepthMap | Failure | None:
    """The depth map that the photograph's own file holds, as an iPhone's HEIC does; None if there is none."""
    if sniff(data) != HEIC:
        return None
    facts = read_heic_depth(data, read_heif_layout(data, has_auxiliaries=True))
    if facts is None or isinstance(facts, Failure):
        return facts
    return decode_heic_depth(
        data,
        size=(facts.width, facts.height),
        orientation=facts.orientation,
        level_range=facts.level_range,
        value_range=facts.value_range,
        is_inverse=facts.is_inverse,
        is_metric=facts.is_metric,
    )


def _thumbnails(photos: Sequence[Photo], estimate: MealEstimate) -> list[Artefact]:
    """Both photographs small, also of a pair that could not be measured."""
    left, second = estimate.colours or (None, None)
    colours = left, second if estimate.second_place == 1 else None
    return [
        Artefact(thumbnail_name(side), "image/jpeg", _jpeg(photo.pixels_bgr, THUMBNAIL_PX, colour)[0])
        for side, photo, colour in zip(PAIR_SLOTS, photos, colours, strict=False)  # there may be one photograph only
    ]


def check_task(arguments: Arguments, _: StageListener) -> Json:
    """Judge a pair before it is sent."""
    request = _CheckRequest.model_validate(arguments)
    left, right = (
        read_reduced_photo(
            path.read_bytes(),
            max_pixels=request.max_pixels,
            least_long_side_px=precheck.LEAST_LONG_SIDE_PX,
        )
        for path in (request.left, request.right)
    )
    camera = camera_from_mapping(request.camera) if request.camera is not None else None
    judged = precheck.check_pair(left, right, parse_marker(request.marker), camera)
    return {
        "ok": judged.is_ok,
        "problems": [{"code": each.code, "severity": each.severity, "side": each.side} for each in judged.problems],
        "measures": dict(judged.measures),
    }


def whole_task(arguments: Arguments, _: StageListener) -> Json:
    """Return whether a JPEG gives all of its pixels, or a depth or confidence map can be used."""
    request = _WholeRequest.model_validate(arguments)
    data = request.photo.read_bytes()
    if request.depth_camera is None:
        failure = why_not_whole(data)
    else:
        camera = depth_camera_from_mapping(request.depth_camera)
        read = read_confidence(data, camera) if request.is_confidence else read_depth(data, camera)
        failure = read if isinstance(read, Failure) else None
    return {"failure": failure_to_json(failure) if failure is not None else None}


def calibrate_task(arguments: Arguments, _: StageListener) -> Json:
    """A camera from photographs of a board."""
    request = _CalibrateRequest.model_validate(arguments)
    photos = _PhotosOnDisk(request.photos, request.max_pixels)
    try:
        fit = calibrate(photos, parse_marker(request.marker))
    except _UnreadablePhotoError as error:
        return {"failure": failure_to_json(error.failure), "photo": error.index}
    if isinstance(fit, Failure):
        return {"failure": failure_to_json(fit), "photo": None}
    return {
        "failure": None,
        "camera": camera_to_json(fit.camera),
        "rms_px": fit.rms_px,
        "reach": fit.reach,
        "model": photos[0].model,
        "used": list(fit.used),
        "left_out": [{"photo": each.index, **failure_to_json(each.failure)} for each in fit.rejected],
    }


class _UnreadablePhotoError(Exception):
    """index: of the photograph, from 0."""

    def __init__(self, index: int, failure: Failure) -> None:
        super().__init__(failure.message)
        self.index = index
        self.failure = failure


class _PhotosOnDisk(Sequence[Photo]):
    """Photographs that are decoded when asked for; the first and the last asked for are held, the others not."""

    def __init__(self, paths: Sequence[Path], max_pixels: int) -> None:
        self._paths = paths
        self._max_pixels = max_pixels
        self._held: dict[int, Photo] = {}

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, index: int) -> Photo: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Photo]: ...

    def __getitem__(self, index: int | slice) -> Photo | Sequence[Photo]:
        if isinstance(index, slice):
            return _PhotosOnDisk(self._paths[index], self._max_pixels)
        path = self._paths[index]
        if index not in self._held:
            photo = read_photo(path.read_bytes(), max_pixels=self._max_pixels)
            if isinstance(photo, Failure):
                raise _UnreadablePhotoError(index, photo)
            self._held = {place: one for place, one in self._held.items() if place == 0} | {index: photo}
        return self._held[index]


def picture_task(arguments: Arguments, _: StageListener) -> Json:
    """A photograph as an upright JPEG without metadata. width_px: at most. colour: estimate_json's; None: as taken."""
    request = _PictureRequest.model_validate(arguments)
    read = read_reduced_photo(
        request.photo.read_bytes(),
        max_pixels=request.max_pixels,
        least_long_side_px=2 * request.width_px,  # so that even the short side of most is as wide as the picture
    )
    if isinstance(read, Failure):
        return {"failure": failure_to_json(read)}
    colour = colour_from_json(request.colour) if request.colour is not None else None
    content, height, width = _jpeg(read.photo.pixels_bgr, request.width_px, colour)
    request.output.write_bytes(content)
    return {"failure": None, "width": width, "height": height}


def describe_task(arguments: Arguments, _: StageListener) -> Json:
    """The vectors (VCM) of regions of one photograph, in the colours that their run saw.

    vcms: one of each region; None where nothing of it is in view.
    """
    request = _DescribeRequest.model_validate(arguments)
    photo = read_photo(request.photo.read_bytes(), max_pixels=request.max_pixels)
    if isinstance(photo, Failure):
        return {"failure": failure_to_json(photo), "vcms": []}
    measured: dict[str | None, ColourCorrection | None] = {}
    vcms: list[JsonValue] = []
    for region in request.regions:
        if region.colour is not None:
            colour: ColourCorrection | None = colour_from_json(region.colour)
        else:
            if region.marker not in measured:
                measured[region.marker] = _colour_by_marker(photo, region.marker)
            colour = measured[region.marker]
        rings = [np.asarray(ring, np.float64) for ring in region.rings]
        vector = describe_rings(photo.pixels_bgr, rings, colour)
        vcms.append(vcm_answer(vector).as_json() if vector is not None else None)
    return {"failure": None, "vcms": vcms}


def classify_task(arguments: Arguments, _: StageListener) -> Json:
    """Probabilities of the labels of an operator's network, by region; None where nothing of a region is in view.

    Without regions the network is loaded and shown a grey picture, which tells whether it fits its description.
    """
    request = _ClassifyRequest.model_validate(arguments)
    content = read_model(request.model, request.sha256)
    network = content if isinstance(content, Failure) else load_network(content)
    if isinstance(network, Failure):
        return {"failure": failure_to_json(network), "probabilities": []}
    photo: Photo | Failure = GREY
    regions = request.regions or [GREY_RINGS]
    if request.regions:
        photo = read_photo(request.photo.read_bytes(), max_pixels=request.max_pixels)
    if isinstance(photo, Failure):
        return {"failure": failure_to_json(photo), "probabilities": []}
    colour = colour_from_json(request.colour) if request.colour is not None else None
    answers: list[JsonValue] = []
    for rings in regions:
        outline = [np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings]
        answer = classify_region(network, request.network_input, photo.pixels_bgr, outline, colour)
        if isinstance(answer, Failure):
            return {"failure": failure_to_json(answer), "probabilities": []}
        answers.append(answer.tolist() if answer is not None else None)
    return {"failure": None, "probabilities": answers}


def _colour_by_marker(photo: Photo, marker: str | None) -> ColourCorrection | None:
    """Return the correction that the pipeline would measure; None: there is no board, or it is not seen."""
    if marker is None:
        return None
    found = find_marker(photo, parse_marker(marker))
    return None if isinstance(found, Failure) else measure_colour(photo, found)


def _jpeg(pixels_bgr: ImageArray, width_px: int, colour: ColourCorrection | None) -> tuple[bytes, int, int]:
    """At most so wide, never enlarged, corrected; with its height and width, px."""
    height, width = pixels_bgr.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        pixels_bgr = np.asarray(cv2.resize(pixels_bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    if colour is not None:
        pixels_bgr = apply_colour(pixels_bgr, colour)
    encoded = cv2.imencode(".jpg", pixels_bgr, [cv2.IMWRITE_JPEG_QUALITY, PICTURE_QUALITY])[1]
    return encoded.tobytes(), int(pixels_bgr.shape[0]), int(pixels_bgr.shape[1])


TASKS: Mapping[str, Callable[[Arguments, StageListener], Json]] = {
    "estimate": estimate_task,
    "check": check_task,
    "whole": whole_task,
    "calibrate": calibrate_task,
    "picture": picture_task,
    "describe": describe_task,
    "classify": classify_task,
}
