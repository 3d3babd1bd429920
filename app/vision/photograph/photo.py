"""Decode one photograph: bytes of JPEG, PNG, WebP or HEIC -> upright 8-bit BGR pixels, and EXIF's lens and phone.

Orientation is applied here, once. Limits are checked on the header, before any pixel is decoded. Colour profiles are
left alone: the marker calibrates colour. Location is never read.
"""

import io
import math
import re
import struct
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import SupportsFloat

import cv2
import numpy as np
import simplejpeg
from PIL import ExifTags, Image, JpegImagePlugin, PngImagePlugin, WebPImagePlugin
from pillow_heif import HeifImageFile

from app.core.errors import Failure
from app.vision.geometry.pictures import reduce_by
from app.vision.model import ImageArray, Photo
from app.vision.photograph.lost_pixels import JPEG_START, PNG_START, lacks_pixels

LEAST_BY_OBJECT_PX = 360  # a coin beside a plate is some 30 px wide there
MIN_SHORT_SIDE_PX = 480  # a marker that is an eighth of the photograph has squares of 7 px there; smaller ones are lost
DIAGONAL_35MM = math.hypot(36.0, 24.0)
FOCAL_35MM_RANGE = (8.0, 400.0)  # outside, the tag is unset (0) or nonsense
MM_PER_RESOLUTION_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit
MILLIMETRE = 4  # of FocalPlaneResolutionUnit
TAKEN_AT = re.compile(r"[\d :]{19}", re.ASCII)
REENCODED_QUALITY = 98
MAX_NAME_LENGTH = 100
HEIF_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"})
# What Pillow and libheif raise on bytes that lie; anything else is a fault of ours and should be seen.
DECODE_ERRORS = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    EOFError,
    OverflowError,
    ZeroDivisionError,
    AttributeError,
    RuntimeError,
    MemoryError,
    struct.error,
    Image.DecompressionBombError,
)
# EXIF orientation -> what makes it upright
TRANSPOSED: Mapping[int, Callable[[cv2.typing.MatLike], cv2.typing.MatLike]] = {
    2: lambda pixels: cv2.flip(pixels, 1),
    3: lambda pixels: cv2.rotate(pixels, cv2.ROTATE_180),
    4: lambda pixels: cv2.flip(pixels, 0),
    5: cv2.transpose,
    6: lambda pixels: cv2.rotate(pixels, cv2.ROTATE_90_CLOCKWISE),
    7: lambda pixels: cv2.rotate(cv2.transpose(pixels), cv2.ROTATE_180),
    8: lambda pixels: cv2.rotate(pixels, cv2.ROTATE_90_COUNTERCLOCKWISE),
}
INVERSE = {6: 8, 8: 6}  # all others undo themselves

SEND_AGAIN = "Send the file again, byte for byte as the camera saved it."


@dataclass(frozen=True, slots=True)
class ReducedPhoto:
    """A photograph of which `factor` x `factor` pixels are one."""

    photo: Photo
    factor: int


def read_photo(
    data: bytes, *, max_pixels: int, least_short_side_px: int = MIN_SHORT_SIDE_PX
) -> Photo | Failure:
    """The photograph in these bytes. least_short_side_px: by default what a marker needs.

    Failures: not_an_image, image_truncated, image_unreadable, image_too_many_pixels (nothing decoded), image_too_small.
    """
    read = read_reduced_photo(
        data,
        max_pixels=max_pixels,
        least_long_side_px=None,
        least_short_side_px=least_short_side_px,
    )
    return read if isinstance(read, Failure) else read.photo


def read_reduced_photo(
    data: bytes,
    *,
    max_pixels: int,
    least_long_side_px: int | None,
    least_short_side_px: int = MIN_SHORT_SIDE_PX,
    is_whole: bool = False,
) -> ReducedPhoto | Failure:
    """The same, halved once or more as long as its long side keeps so many pixels; None: in full. Failures: the same.

    A JPEG is reduced while it is decoded (by its cosine transform), which takes half the time. is_whole: no pixels can
    be missing, so that none are looked for.
    """
    with warnings.catch_warnings():
        # It warns of damaged EXIF entries; the sound ones are read.
        warnings.filterwarnings("ignore", module=r"PIL\.")
        return _read(data, max_pixels, least_long_side_px, least_short_side_px, is_whole=is_whole)


def _read(
    data: bytes,
    max_pixels: int,
    least_long_side_px: int | None,
    least_short_side_px: int,
    *,
    is_whole: bool,
) -> ReducedPhoto | Failure:
    opener = _opener(data)
    if opener is None:
        return Failure(
            "not_an_image", "The file is no photograph.", "Send a JPEG, PNG, WebP or HEIC file."
        )
    try:
        image = opener(io.BytesIO(data))
    except DECODE_ERRORS:
        return _damaged(data)
    if getattr(image, "is_animated", False) and isinstance(image, WebPImagePlugin.WebPImageFile):
        return _damaged(data)
    width, height = image.size
    if width * height > max_pixels:
        return Failure(
            "image_too_many_pixels",
            f"The photograph has {width} x {height} = {width * height} pixels; at most {max_pixels} are accepted.",
            "Choose a smaller picture size in the camera's settings.",
        )
    if min(width, height) < least_short_side_px:
        return Failure(
            "image_too_small",
            f"The photograph has only {width} x {height} pixels; the shorter needs {least_short_side_px} at least.",
            "Send the photograph itself, not its preview.",
        )
    try:
        factor = _reduction(max(width, height), least_long_side_px)
        pixels_bgr = _stored_pixels(image, data, factor, is_whole=is_whole)
    except DECODE_ERRORS:
        return _damaged(data)
    if isinstance(pixels_bgr, Failure):
        return pixels_bgr
    exif = _exif(image)
    # libheif has turned its pixels already, and says so in the same tag
    if not isinstance(image, HeifImageFile):
        turn = TRANSPOSED.get(_whole_number(exif.get(ExifTags.Base.Orientation)))
        pixels_bgr = (
            pixels_bgr if turn is None else np.ascontiguousarray(turn(pixels_bgr), np.uint8)
        )
    photo = Photo(
        pixels_bgr, _focal_35mm(exif, width, height), _name(exif.get(ExifTags.Base.Model))
    )
    return ReducedPhoto(photo, factor)


def encode_photo(
    photo: Photo, *, is_lossless: bool, orientation: int, taken_at: str | None
) -> bytes:
    """A photograph written anew as PNG or JPEG: its only metadata are focal length, orientation and time.

    orientation: EXIF's, in which it is stored. taken_at: EXIF's local time.
    """
    turn = TRANSPOSED.get(INVERSE.get(orientation, orientation))
    stored = photo.pixels_bgr if turn is None else turn(photo.pixels_bgr)
    image = Image.fromarray(cv2.cvtColor(stored, cv2.COLOR_BGR2RGB))
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    details = exif.get_ifd(ExifTags.IFD.Exif)
    if taken_at is not None:
        details[ExifTags.Base.DateTimeOriginal] = taken_at
    if photo.focal_35mm is not None:  # not as a 35 mm equivalent, which is a whole number
        details[ExifTags.Base.FocalLength] = photo.focal_35mm
        details[ExifTags.Base.FocalPlaneXResolution] = math.hypot(*image.size) / DIAGONAL_35MM
        details[ExifTags.Base.FocalPlaneResolutionUnit] = MILLIMETRE
    stream = io.BytesIO()
    if is_lossless:
        image.save(stream, "PNG", exif=exif)
    else:
        image.save(stream, "JPEG", quality=REENCODED_QUALITY, subsampling=0, exif=exif)
    return stream.getvalue()


def read_taken_at(data: bytes) -> str | None:
    """EXIF's local time of a readable photograph, or None."""
    opener = _opener(data)
    taken_at = (
        _exif(opener(io.BytesIO(data))).get(ExifTags.Base.DateTimeOriginal)
        if opener is not None
        else None
    )
    return taken_at if isinstance(taken_at, str) and TAKEN_AT.fullmatch(taken_at) else None


def _reduction(long_side_px: int, least_long_side_px: int | None) -> int:
    """1, 2, 4 or 8: what both OpenCV and the JPEG's cosine transform can do."""
    if least_long_side_px is None:
        return 1
    return max(
        factor
        for factor in (1, 2, 4, 8)
        if factor == 1 or long_side_px >= factor * least_long_side_px
    )


def _opener(data: bytes) -> Callable[[io.BytesIO], Image.Image] | None:
    """The class that reads such bytes, by their first ones.

    Classes instead of Image.open: of Pillow's many formats these few only, and its own pixel limit stays out of the
    way.
    """
    if data.startswith(JPEG_START):
        return JpegImagePlugin.JpegImageFile
    if data.startswith(PNG_START):
        return PngImagePlugin.PngImageFile
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return WebPImagePlugin.WebPImageFile
    if data[4:8] == b"ftyp" and data[8:12] in HEIF_BRANDS:
        return HeifImageFile
    return None


def _damaged(data: bytes) -> Failure:
    if not _is_complete(data):
        return Failure("image_truncated", "The photograph's file ends too early.", SEND_AGAIN)
    return Failure("image_unreadable", "The photograph's file is damaged.", SEND_AGAIN)


def _is_complete(data: bytes) -> bool:
    """Whether the file has its end: JPEG's and PNG's end marks, all of WebP's bytes and of HEIC's boxes."""
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9", _jpeg_scan_offset(data) or 2) > 2
    if data.startswith(b"\x89PNG"):
        return b"IEND" in data[-64:]
    if data.startswith(b"RIFF"):
        return len(data) >= 8 + int.from_bytes(data[4:8], "little")
    position = 0
    while position + 8 <= len(data):
        size = int.from_bytes(data[position : position + 4])
        if size == 1:  # a 64-bit size follows the type
            size = int.from_bytes(data[position + 8 : position + 16])
        if size == 0:  # to the end of the file
            return True
        if size < 8:
            return True  # nonsense, not a cut
        position += size
    return position == len(data)


def _stored_pixels(
    image: Image.Image, data: bytes, factor: int, *, is_whole: bool
) -> ImageArray | Failure:
    """Return (H, W, 3) uint8 BGR as stored, reduced by the factor; a Failure if pixels are missing.

    libjpeg-turbo decodes a JPEG in half of Pillow's time. If it has no complaint, no pixels are missing.
    """
    is_jpeg = isinstance(image, JpegImagePlugin.JpegImageFile) and image.mode in {"RGB", "L"}
    size = (-(-image.width // factor), -(-image.height // factor))
    decoded = _jpeg_pixels(data, size, factor, is_strict=True) if is_jpeg else None
    if decoded is None and not is_whole and lacks_pixels(data):
        return _damaged(data)
    if decoded is None and is_jpeg and _is_complete(data):
        decoded = _jpeg_pixels(data, size, factor, is_strict=False)
    return reduce_by(_pixels_bgr(image), factor) if decoded is None else decoded


def _jpeg_pixels(
    data: bytes, size: tuple[int, int], factor: int, *, is_strict: bool
) -> ImageArray | None:
    """Pixels by libjpeg-turbo, size: width, height; None for what is left to Pillow.

    is_strict: None wherever it complains; else it fills up with grey what a cut file lacks.
    """
    try:
        decoded = simplejpeg.decode_jpeg(
            data, "BGR", min_width=size[0], min_height=size[1], min_factor=factor, strict=is_strict
        )
    except ValueError:
        return None
    return decoded if decoded.shape[1::-1] == size else None


def _jpeg_scan_offset(data: bytes) -> int | None:
    """Where the first scan's header begins, by walking the segments before it; None if they are broken."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF:
        kind = data[position + 1]
        if kind == 0xFF:  # fill bytes may precede a marker
            position += 1
            continue
        if kind == 0xDA:
            return position
        position += 2 + int.from_bytes(data[position + 2 : position + 4])
    return None


def _pixels_bgr(image: Image.Image) -> ImageArray:
    """(H, W, 3) uint8 BGR as stored, not turned: 16 bits scaled to 8, transparency on white."""
    image.load()
    if image.mode.startswith("I"):
        grey = np.clip(np.asarray(image).astype(np.float64) / 257.0 + 0.5, 0, 255).astype(np.uint8)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
    if image.has_transparency_data:
        layer = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", layer.size, (255, 255, 255, 255)), layer)
    rgb = image if image.mode == "RGB" else image.convert("RGB")
    return np.asarray(cv2.cvtColor(np.asarray(rgb), cv2.COLOR_RGB2BGR), np.uint8)


def _exif(image: Image.Image) -> Mapping[int, object]:
    """EXIF's main and sub directory as one; empty if it cannot be read."""
    try:
        exif = image.getexif()
        return dict(exif) | dict(exif.get_ifd(ExifTags.IFD.Exif))
    except DECODE_ERRORS:
        return {}


def _focal_35mm(exif: Mapping[int, object], width: int, height: int) -> float | None:
    """35 mm equivalent focal length, mm: the tag, or focal length over the sensor's diagonal, or None.

    width, height: of the image as stored, for files that do not tell the size that the resolution belongs to.
    """
    focal_35mm = _positive(exif.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if focal_35mm is None:
        focal_mm = _positive(exif.get(ExifTags.Base.FocalLength))
        per_unit = _positive(exif.get(ExifTags.Base.FocalPlaneXResolution))
        unit_mm = MM_PER_RESOLUTION_UNIT.get(
            _whole_number(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
        )
        if focal_mm is None or per_unit is None or unit_mm is None:
            return None
        columns = _positive(exif.get(ExifTags.Base.ExifImageWidth)) or width
        rows = _positive(exif.get(ExifTags.Base.ExifImageHeight)) or height
        focal_35mm = focal_mm * per_unit / unit_mm / math.hypot(columns, rows) * DIAGONAL_35MM
    return focal_35mm if FOCAL_35MM_RANGE[0] <= focal_35mm <= FOCAL_35MM_RANGE[1] else None


def _name(value: object) -> str | None:
    if not isinstance(value, str):
        return None
    printable = "".join(character for character in value if character.isprintable()).strip()
    return printable[:MAX_NAME_LENGTH] or None


def _positive(value: object) -> float | None:
    """A finite number above zero, or None: EXIF may hold 1/0, text, bytes or lists anywhere."""
    if not isinstance(value, SupportsFloat | str | bytes):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _whole_number(value: object) -> int:
    """The number, or 0, which is no value of any EXIF enumeration that is read here."""
    number = _positive(value)
    return int(number) if number is not None else 0
