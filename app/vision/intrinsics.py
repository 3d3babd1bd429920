"""A camera's intrinsics as values: from a camera file's keys, and adapted to a photograph of another size.

board/camera.py finds the camera of photographs; the API, which keeps and chooses cameras, needs no NumPy for it.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from app.core.errors import Failure, InvalidInputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

CAMERA_KEYS = ("width", "height", "fx", "fy", "cx", "cy")
LARGEST = 1e9  # of a number in a camera or rig file
ROUNDING_PX = 1.0  # a scaled photograph's sides are whole numbers
# of a board's corners, reprojected: as good as phones and printed boards get
TOLERATED_RMS_PX = 0.5


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole intrinsics in px for an upright image of this size, distortion (k1, k2, p1, p2, k3) as in OpenCV.

    source: "given" (a calibration file or a stored camera), "exif" (focal length from EXIF, refined on the board),
    "board" (no EXIF either: focal length from the board alone).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    source: Literal["given", "exif", "board"] = "given"

    @property
    def matrix(self) -> "NDArray[np.float64]":
        """(3, 3) intrinsic matrix K (paper, eq. 3 and 10, without skew)."""
        import numpy as np  # noqa: PLC0415  # the API process has cameras, and no NumPy

        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Return a camera with the keys of a camera file."""
    return asdict(camera) | {"distortion": list(camera.distortion)}


def _invalid(reason: str) -> InvalidInputError:
    return InvalidInputError(f"The camera cannot be used: {reason}", code="camera_invalid")


def number_from(
    value: object, key: str, invalid: Callable[[str], InvalidInputError] = _invalid
) -> float:
    """A finite number of JSON. Raises what `invalid` makes of the reason."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise invalid(f"{key} takes numbers, not {str(value)[:40]!r}.")
    return float(value)


def camera_from_mapping(
    data: object, invalid: Callable[[str], InvalidInputError] = _invalid
) -> Camera:
    """A Camera from parsed JSON: width, height, fx, fy, cx, cy, distortion [k1, k2, p1, p2, k3].

    Other keys are ignored. Raises what `invalid` makes of the reason: InvalidInputError, code "camera_invalid".
    """
    if not isinstance(data, Mapping):
        raise invalid("it must be an object with " + ", ".join(CAMERA_KEYS) + " and distortion.")
    if missing := [key for key in CAMERA_KEYS if key not in data]:
        raise invalid("it lacks " + ", ".join(missing) + ".")
    width, height, fx, fy, cx, cy = (number_from(data[key], key, invalid) for key in CAMERA_KEYS)
    for key, side in (("width", width), ("height", height)):
        if side != int(side) or not 1 <= side <= 100_000:
            raise invalid(f"{key} must be a whole number of pixels, not {side:g}.")
    for key, focal in (("fx", fx), ("fy", fy)):
        if not 0.1 * max(width, height) <= focal <= 20.0 * max(width, height):
            raise invalid(
                f"{key} = {focal:g} is no focal length in px for {width:g} x {height:g} px."
            )
    if not (0 <= cx < width and 0 <= cy < height):
        raise invalid(
            f"the principal point ({cx:g}, {cy:g}) lies outside the image of {width:g} x {height:g} px."
        )
    listed = data.get("distortion", ())
    if not isinstance(listed, list | tuple) or len(listed) not in (0, 4, 5):
        raise invalid("distortion must be the list [k1, k2, p1, p2, k3].")
    k1, k2, p1, p2, k3 = [number_from(value, "distortion", invalid) for value in listed] + [0.0] * (
        5 - len(listed)
    )
    return Camera(int(width), int(height), fx, fy, cx, cy, (k1, k2, p1, p2, k3), "given")


def adapt_camera(camera: Camera, width: int, height: int) -> Camera | Failure:
    """The camera for a photograph of the same framing: same size, scaled by one ratio, or turned by a quarter.

    A landscape camera is turned clockwise for a portrait photograph, as EXIF orientation 6 does (a phone held
    upright), and a portrait camera counter-clockwise, its inverse. The other direction would differ only in which way
    the principal point and the tangential distortion are off, some px. Any other size: Failure "camera_mismatch".
    """
    if (camera.width > camera.height) != (width > height) and camera.width != camera.height:
        camera = _turned(camera)
    sx, sy = width / camera.width, height / camera.height
    if (
        abs(height - camera.height * sx) > ROUNDING_PX
        and abs(width - camera.width * sy) > ROUNDING_PX
    ):
        return Failure(
            "camera_mismatch",
            f"The camera file describes {camera.width} x {camera.height} px, the photograph has {width} x {height} px, "
            "which is neither that size nor it scaled or turned by a quarter.",
            "Calibrate with photographs of the same shape, without cropping or digital zoom, or send no camera.",
        )
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5,
        cy=(camera.cy + 0.5) * sy - 0.5,
    )


def _turned(camera: Camera) -> Camera:
    """A landscape camera turned by a quarter clockwise, a portrait one counter-clockwise.

    Clockwise (x, y) -> (height - 1 - y, x): normalised (x, y) -> (-y, x), under which the tangential distortion of
    OpenCV's model keeps its form with (p1, p2) -> (p2, -p1).
    """
    k1, k2, p1, p2, k3 = camera.distortion
    if camera.width > camera.height:
        cx, cy, p1, p2 = camera.height - 1 - camera.cy, camera.cx, p2, -p1
    else:
        cx, cy, p1, p2 = camera.cy, camera.width - 1 - camera.cx, -p2, p1
    return Camera(
        camera.height,
        camera.width,
        camera.fy,
        camera.fx,
        cx,
        cy,
        (k1, k2, p1, p2, k3),
        camera.source,
    )
