"""A child's task: regions of one photograph described again. JSON in, JSON out; the photograph by path."""

import base64
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import Failure
from app.services.estimate_json import failure_to_json
from app.vision.color import apply_colour
from app.vision.model import ColourCorrection
from app.vision.photo import read_photo
from app.vision.vcm import VCM_VERSION, describe
from app.vision.vcm_region import region_of_rings


def describe_task(request: Mapping[str, Any], _: Callable[[str], None]) -> dict[str, Any]:
    """The regions' vectors (VCM) in the colours that their run saw.

    request: photo (path), max_pixels, regions: [{"rings": [[[x, y], ...], ...] px, "colour": {"kind", "matrix"} or
    null: the pixels as they are}]. vectors: base64 of little-endian float16; null where nothing of it is in view.
    """
    photo = read_photo(Path(request["photo"]).read_bytes(), max_pixels=int(request["max_pixels"]))
    if isinstance(photo, Failure):
        return {"failure": failure_to_json(photo), "vcm_version": VCM_VERSION, "vectors": []}
    vectors = []
    for asked in request["regions"]:
        rings = [np.asarray(ring, np.float64) for ring in asked["rings"]]
        region = region_of_rings(photo.pixels_bgr, rings)
        if region is not None and asked["colour"] is not None:
            colour = ColourCorrection(np.asarray(asked["colour"]["matrix"], np.float64), asked["colour"]["kind"])
            region = type(region)(apply_colour(region.pixels_bgr, colour), region.mask)
        vectors.append(_encoded(describe(region)) if region is not None else None)
    return {"failure": None, "vcm_version": VCM_VERSION, "vectors": vectors}


def _encoded(vector: np.ndarray) -> str:
    return base64.b64encode(vector.astype("<f2").tobytes()).decode()
