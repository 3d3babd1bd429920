"""A photograph as a small upright JPEG without metadata, in corrected colours."""

from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel

from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.estimate.estimate_json import colour_from_json, failure_to_json
from app.meals.stored.run_answer import Json
from app.vision.board.colour_correction import apply_colour
from app.vision.model import ColourCorrection, ImageArray
from app.vision.photo import read_reduced_photo

PICTURE_QUALITY = 85  # of JPEG: no artefacts to be seen at a screen's size


class _PictureRequest(BaseModel):
    photo: Path
    output: Path
    width_px: int
    max_pixels: int
    colour: Json | None


def picture_task(arguments: Arguments, _: StageListener) -> Json:
    """A photograph as an upright JPEG without metadata. width_px: at most. colour: estimate_json's; None: as taken."""
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
