"""The children's small tasks on photographs: check a pair, make a picture for eyes, describe or classify regions.

A region's looks are its vector (VCM), and the labels that an operator's network gives it.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, JsonValue

from app.candidates.classify import read_model
from app.candidates.vcm_json import vcm_answer
from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.estimate.estimate_json import colour_from_json, failure_to_json
from app.meals.stored.run_answer import Json
from app.vision import precheck
from app.vision.board.colour_correction import apply_colour, measure_colour
from app.vision.board.marker import find_marker
from app.vision.intrinsics import camera_from_mapping
from app.vision.known_object import parse_scale
from app.vision.looks.food_model import NetworkInput, classify_region, load_network
from app.vision.looks.vcm import describe, describe_rings
from app.vision.looks.vcm_region import SIDE_PX, regions_of_whole
from app.vision.marker_spec import MarkerSpec
from app.vision.model import ColourCorrection, ImageArray, Photo
from app.vision.photograph.photo import ReducedPhoto, read_photo, read_reduced_photo

PICTURE_QUALITY = 85  # of JPEG: no artefacts to be seen at a screen's size


class _PictureRequest(BaseModel):
    photo: Path
    output: Path
    width_px: int
    max_pixels: int
    colour: Json | None


def picture_task(arguments: Arguments, _: StageListener) -> Json:
    """A photograph as an upright JPEG without metadata.

    width_px: at most. colour: estimate_json's; None: as taken.
    """
    request = _PictureRequest.model_validate(arguments)
    read = read_reduced_photo(
        request.photo.read_bytes(),
        max_pixels=request.max_pixels,
        least_long_side_px=2
        * request.width_px,  # so that even the short side of most is as wide as the picture
    )
    if isinstance(read, Failure):
        return {"failure": failure_to_json(read)}
    colour = colour_from_json(request.colour) if request.colour is not None else None
    content, height, width = encode_jpeg(read.photo.pixels_bgr, request.width_px, colour)
    request.output.write_bytes(content)
    return {"failure": None, "width": width, "height": height}


def encode_jpeg(
    pixels_bgr: ImageArray, width_px: int, colour: ColourCorrection | None
) -> tuple[bytes, int, int]:
    """At most so wide, never enlarged, corrected; with its height and width, px."""
    height, width = pixels_bgr.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        pixels_bgr = np.asarray(
            cv2.resize(pixels_bgr, size, interpolation=cv2.INTER_AREA), np.uint8
        )
    if colour is not None:
        pixels_bgr = apply_colour(pixels_bgr, colour)
    encoded = cv2.imencode(".jpg", pixels_bgr, [cv2.IMWRITE_JPEG_QUALITY, PICTURE_QUALITY])[1]
    return encoded.tobytes(), int(pixels_bgr.shape[0]), int(pixels_bgr.shape[1])


class _CheckRequest(BaseModel):
    """left, right: paths of both photographs."""

    left: Path
    right: Path
    max_pixels: int
    marker: str
    camera: Json | None


def check_task(arguments: Arguments, _: StageListener) -> Json:
    """Judge a pair before it is sent."""
    request = _CheckRequest.model_validate(arguments)

    def read(path: Path) -> ReducedPhoto | Failure:
        return read_reduced_photo(
            path.read_bytes(),
            max_pixels=request.max_pixels,
            least_long_side_px=precheck.LEAST_LONG_SIDE_PX,
        )

    with ThreadPoolExecutor(2) as threads:  # decoders let go of the interpreter
        left, right = threads.map(read, (request.left, request.right))
    camera = camera_from_mapping(request.camera) if request.camera is not None else None
    judged = precheck.check_pair(left, right, parse_scale(request.marker), camera)
    return {
        "ok": judged.is_ok,
        "problems": [
            {"code": problem.code, "severity": problem.severity, "side": problem.side}
            for problem in judged.problems
        ],
        "measures": dict(judged.measures),
    }


GREY = Photo(np.full((64, 64, 3), 128, np.uint8))  # what a network is tried on
GREY_RINGS = [[(8.0, 8.0), (56.0, 8.0), (56.0, 56.0), (8.0, 56.0)]]


class _RegionRequest(BaseModel):
    """rings: px.

    colour: what the run kept of the photograph's; None: it is measured by the marker, if there is
    one.
    """

    rings: list[list[tuple[float, float]]]
    colour: Json | None
    marker: str | None


class _DescribeRequest(BaseModel):
    """regions: None: the food fills the photograph, of which there are several views."""

    photo: Path
    max_pixels: int
    regions: list[_RegionRequest] | None


class _ClassifyRequest(BaseModel):
    """regions: rings of each, px. network_input: of food_model.NetworkInput."""

    photo: Path
    max_pixels: int
    regions: list[list[list[tuple[float, float]]]]
    colour: Json | None
    model: Path
    sha256: str
    network_input: NetworkInput


def describe_task(arguments: Arguments, _: StageListener) -> Json:
    """The vectors (VCM) of regions of one photograph, in the colours that their run saw.

    vcms: one of each region; None where nothing of it is in view.
    """
    request = _DescribeRequest.model_validate(arguments)
    photo = read_photo(
        request.photo.read_bytes(), max_pixels=request.max_pixels, least_short_side_px=SIDE_PX
    )
    if isinstance(photo, Failure):
        return {"failure": failure_to_json(photo), "vcms": []}
    if request.regions is None:
        views = regions_of_whole(photo.pixels_bgr)
        return {"failure": None, "vcms": [vcm_answer(describe(view)).as_json() for view in views]}
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

    Without regions the network is loaded and shown a grey picture, which tells whether it fits its
    description.
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
    board = parse_scale(marker) if marker is not None else None
    if not isinstance(board, MarkerSpec):
        return None
    observation = find_marker(photo, board)
    return None if isinstance(observation, Failure) else measure_colour(photo, observation)
