"""Photographs as the pipeline takes them: decoded, each with its depth map.

Files by view in -> Photos, or why one cannot be read. What the pipeline makes of them: run_estimate.py.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from app.core.errors import Failure
from app.photos.heic_depth import read_heic_depth
from app.photos.heif import read_heif_layout
from app.photos.inspect import HEIC, PhotoFacts, inspect_photo, sniff
from app.vision.depth_camera import depth_camera_from_mapping
from app.vision.depth_map import read_depth
from app.vision.heic_depth import decode_heic_depth
from app.vision.model import DepthMap, EstimateOptions, Photo
from app.vision.photo import read_photo


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


def read_photographs(
    photographs: Mapping[str, Path],
    options: EstimateOptions,
    max_pixels: int,
    depths: Mapping[str, DepthFiles],
    *,
    is_depth_needed: bool,
) -> tuple[list[Photo], tuple[str, ...]] | Failure:
    """The photographs with their depth maps, and flags for maps that are left out. See run_estimate.py."""
    photos: list[Photo] = []
    unused: tuple[str, ...] = ()
    for side, path in photographs.items():
        read = read_photo(path.read_bytes(), max_pixels=max_pixels)
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
