"""The child's task of reading the barcodes of packs."""

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import zxingcpp
from pydantic import BaseModel

from app.children.child import Arguments, StageListener
from app.core.errors import Failure
from app.meals.estimate.estimate_json import failure_to_json
from app.meals.stored.run_answer import Json
from app.vision.model import ImageArray
from app.vision.photograph.photo import read_reduced_photo

# at least, tried in turn: bars are read from 3 px on, as in a barcode of a fifth, or a tenth, of the picture
LONG_SIDES_PX = (1600, 3200)
TURNS_DEG = (0.0, 22.5, 45.0, 67.5)  # the reader follows lines along and across the picture
BLUR_PX, SHARPENING = 2.0, 1.5
READ_TWICE = 2
# not UPC-E: half an EAN-13 is often taken for one
FORMATS = zxingcpp.barcode_formats_from_str("EAN13,EAN8,UPCA")


class _BarcodeRequest(BaseModel):
    photo: Path
    max_pixels: int


def barcode_task(arguments: Arguments, _: StageListener) -> Json:
    """Return the digits of the barcodes in a photograph, under `barcodes`."""
    request = _BarcodeRequest.model_validate(arguments)
    content = request.photo.read_bytes()
    barcodes: list[str] = []
    for least_long_side_px in LONG_SIDES_PX:
        read = read_reduced_photo(
            content, max_pixels=request.max_pixels, least_long_side_px=least_long_side_px
        )
        if isinstance(read, Failure):
            return {"failure": failure_to_json(read), "barcodes": []}
        barcodes = read_barcodes(read.photo.pixels_bgr)
        if barcodes:
            break
    return {"failure": None, "barcodes": [*barcodes]}


def read_barcodes(pixels_bgr: ImageArray) -> list[str]:
    """Return the digits of the barcodes.

    A blurred one is misread now and then, with a check digit that fits, but never the same way:
    those count that are read as often as others in the picture turned and sharpened.
    """
    grey = cv2.cvtColor(pixels_bgr, cv2.COLOR_BGR2GRAY)
    height, width = grey.shape
    side = int(np.hypot(height, width))
    reads: Counter[str] = Counter()
    for turn_deg in TURNS_DEG:
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1.0)
        turn[:, 2] += (side - width) / 2, (side - height) / 2
        turned = cv2.warpAffine(grey, turn, (side, side), flags=cv2.INTER_CUBIC)
        blurred = cv2.GaussianBlur(turned, (0, 0), BLUR_PX)
        sharpened = cv2.addWeighted(turned, 1 + SHARPENING, blurred, -SHARPENING, 0)
        for picture in (turned, sharpened):
            reads.update({code.text for code in zxingcpp.read_barcodes(picture, formats=FORMATS)})
    enough = max(READ_TWICE, max(reads.values(), default=0) / 2)
    return sorted(digits for digits, count in reads.items() if count >= enough)
