"""A child's task: regions of one photograph described again. JSON in, JSON out; the photograph by path."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.candidates.vcm_json import vcm_answer
from app.core.errors import Failure
from app.estimates.estimate_json import colour_from_json, failure_to_json
from app.vision.board.colour_correction import measure_colour
from app.vision.board.marker import find_marker
from app.vision.looks.vcm import describe_rings
from app.vision.marker_spec import parse_marker
from app.vision.model import ColourCorrection, Photo
from app.vision.photo import read_photo


def describe_task(request: Mapping[str, Any], _: Callable[[str], None]) -> dict[str, object]:
    """The regions' vectors (VCM) in the colours that their run saw.

    request: photo (path), max_pixels, regions: [{"rings": [[[x, y], ...], ...] px, "colour": what the run kept of the
    photograph's (estimate_json), null: its pipeline corrected none yet, "marker": by which it is measured then}].
    vcms: vcm_json's; null where nothing of the region is in view.
    """
    photo = read_photo(Path(request["photo"]).read_bytes(), max_pixels=int(request["max_pixels"]))
    if isinstance(photo, Failure):
        return {"failure": failure_to_json(photo), "vcms": []}
    measured: dict[str, ColourCorrection | None] = {}
    vcms = []
    for asked in request["regions"]:
        if asked["colour"] is not None:
            colour: ColourCorrection | None = colour_from_json(asked["colour"])
        else:
            if asked["marker"] not in measured:
                measured[asked["marker"]] = _colour_by_marker(photo, asked["marker"])
            colour = measured[asked["marker"]]
        rings = [np.asarray(ring, np.float64) for ring in asked["rings"]]
        vector = describe_rings(photo.pixels_bgr, rings, colour)
        vcms.append(vcm_answer(vector).as_json() if vector is not None else None)
    return {"failure": None, "vcms": vcms}


def _colour_by_marker(photo: Photo, marker: str) -> ColourCorrection | None:
    """As the pipeline measures it; None where the board is not found: the pixels as they are."""
    found = find_marker(photo, parse_marker(marker))
    return None if isinstance(found, Failure) else measure_colour(photo, found)
