"""The estimate of a meal in a child process: photographs by path in, the pipeline's answer and its pictures out."""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import BaseModel

from app.candidates.identify_photo import form_index_version, likely_foods
from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.estimate.estimate_json import answer_of, options_from_json
from app.meals.estimate.photo_tasks import encode_jpeg
from app.meals.stored.run_answer import (
    THUMBNAIL_PX,
    ArtefactAnswer,
    Json,
    RunAnswer,
    thumbnail_name,
)
from app.photos.heic_depth import read_heic_depth
from app.photos.heif import read_heif_layout
from app.photos.inspect import HEIC, PhotoFacts, inspect_photo, sniff
from app.photos.slots import PAIR_SLOTS
from app.vision.model import (
    Artefact,
    DepthMap,
    EstimateOptions,
    Float64Array,
    LikelyFood,
    MealEstimate,
    Photo,
    PhotoPair,
)
from app.vision.photograph.depth_camera import depth_camera_from_mapping
from app.vision.photograph.depth_map import read_depth
from app.vision.photograph.heic_depth import decode_heic_depth
from app.vision.photograph.photo import LEAST_BY_OBJECT_PX, MIN_SHORT_SIDE_PX, read_photo
from app.vision.pipeline import estimate_meal
from app.vision.version import PIPELINE_VERSION


@dataclass(frozen=True, slots=True)
class DepthFiles:
    """A depth map, its camera (depth_map.py's keys), and what is known of its confidence."""

    depth: Path
    camera: Mapping[str, float]
    confidence: Path | None = None

    def read(self, *, is_landscape: bool | None = None) -> DepthMap | Failure:
        """The map. is_landscape: of its upright photograph; None: either way.

        Failures: see read_depth; depth_mismatch of a turned map. Raises OSError, InvalidInputError
        (the camera).
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


def read_photographs(
    photographs: Mapping[str, Path],
    options: EstimateOptions,
    max_pixels: int,
    depths: Mapping[str, DepthFiles],
    *,
    is_depth_needed: bool,
) -> tuple[list[Photo], tuple[str, ...]] | Failure:
    """The photographs with their depth maps, and flags for maps that are left out.

    See run_estimate.py.
    """
    least_px = MIN_SHORT_SIDE_PX if options.known is None else LEAST_BY_OBJECT_PX
    photos: list[Photo] = []
    unused: tuple[str, ...] = ()
    for side, path in photographs.items():
        read = read_photo(path.read_bytes(), max_pixels=max_pixels, least_short_side_px=least_px)
        if isinstance(read, Failure):
            return Failure(read.code, f"The {side} photograph: {read.message}", read.advice)
        photo = read
        depth: DepthMap | Failure | None = None
        if side in depths:
            height, width = photo.pixels_bgr.shape[:2]
            depth = depths[side].read(is_landscape=None if width == height else width > height)
            if isinstance(depth, Failure) and is_depth_needed:
                return depth
        elif options.method == "shape" and len(photographs) == 1:  # of two, the pair knows more
            depth = _depth_inside(path.read_bytes())
        if isinstance(depth, Failure):
            unused = ("depth_ignored",)
        else:
            photo = replace(photo, depth=depth)
        if options.poses is not None:  # they are of the picture as it is stored
            facts = inspect_photo(path)
            photo = replace(
                photo, orientation=facts.orientation if isinstance(facts, PhotoFacts) else 1
            )
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


class _EstimateRequest(BaseModel):
    """photographs: paths by view, in the order of VIEW_SLOTS. depths: of some of them."""

    photographs: dict[str, Path]
    depths: dict[str, DepthFiles] = {}
    max_pixels: int
    output_dir: Path
    options: Json
    food_index: Path | None = None


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

    photographs: by name, left, right, then others
    depths: depth maps of some
    is_depth_needed: otherwise a map that cannot be used is left out, with the flag depth_ignored:
        it is one more measurement
    index: of foods, whose candidates tell a single view's forms; None: the shipped one
    Raises OSError if a file cannot be read.
    """
    started = time.perf_counter()
    on_stage("read")
    read = read_photographs(
        photographs, options, max_pixels, depths or {}, is_depth_needed=is_depth_needed
    )
    read_seconds = time.perf_counter() - started
    if isinstance(read, Failure):
        stages = {"read": read_seconds}
        return answer_of(
            MealEstimate(options.method, PIPELINE_VERSION, stages, failure=read), options
        ), None
    photos, unused = read
    has_used_index = False

    def foods_by_looks(vector: Float64Array) -> Sequence[LikelyFood]:
        nonlocal has_used_index
        has_used_index = True
        return likely_foods(vector, index)

    options = replace(options, foods_by_looks=foods_by_looks)
    pair = PhotoPair(photos[0], photos[1] if len(photos) > 1 else None, tuple(photos[2:]))
    estimate = estimate_meal(pair, options, on_stage=on_stage, want_artefacts=want_artefacts)
    items = tuple(
        replace(item, flags=(*dict.fromkeys((*item.flags, *unused)),)) for item in estimate.items
    )
    estimate = replace(estimate, items=items)
    answer = answer_of(estimate, options)
    if has_used_index:
        answer.parameters["form_index"] = form_index_version(index)
    answer.stages = {"read": round(read_seconds, 4), **answer.stages}
    answer.seconds = round(time.perf_counter() - started, 4)
    if want_artefacts:
        estimate = replace(
            estimate, artefacts=[*estimate.artefacts, *_thumbnails(photos[:2], estimate)]
        )
    return answer, estimate


def _thumbnails(photos: Sequence[Photo], estimate: MealEstimate) -> list[Artefact]:
    """Both photographs small, also of a pair that could not be measured."""
    left, second = estimate.colours or (None, None)
    colours = left, second if estimate.second_place == 1 else None
    return [
        Artefact(
            thumbnail_name(side),
            "image/jpeg",
            encode_jpeg(photo.pixels_bgr, THUMBNAIL_PX, colour)[0],
        )
        for side, photo, colour in zip(
            PAIR_SLOTS, photos, colours, strict=False
        )  # there may be one photograph only
    ]
