"""A child's task: regions of one photograph described again. JSON in, JSON out; the photograph by path."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import Failure
from app.services.estimate_json import failure_to_json, vector_to_json
from app.vision.model import ColourCorrection
from app.vision.photo import read_photo
from app.vision.vcm import VCM_VERSION, describe_rings


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
        colour = None
        if asked["colour"] is not None:
            colour = ColourCorrection(np.asarray(asked["colour"]["matrix"], np.float64), asked["colour"]["kind"])
        vector = describe_rings(photo.pixels_bgr, rings, colour)
        vectors.append(vector_to_json(vector) if vector is not None else None)
    return {"failure": None, "vcm_version": VCM_VERSION, "vectors": vectors}
