"""The printed ArUco or ChArUco board in a photograph: which of its points are seen, and where.

Photo and announced marker in -> the corners of its tags, or the corners of its squares, that are in view
(CONVENTIONS.md, "Marker"), or a Failure that tells what is seen instead. Tags carry their numbers, so that a board may
be partly covered, and has one reading. Tags: OpenCV's aruco module (Garrido-Jurado et al., 2014).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.grid import reduced
from app.vision.board.print_layout import border_share, print_points_mm, tag_corners_mm
from app.vision.board.quality import judge_photograph, judge_tags
from app.vision.board.tag_edges import grow_tags, ink_gain_px, refine_tags
from app.vision.geometry.pictures import grey_of
from app.vision.geometry.projective import map_points
from app.vision.marker_spec import DICTIONARIES, MarkerSpec, TagBoard
from app.vision.model import (
    Float64Array,
    ImageArray,
    Int64Array,
    MarkerObservation,
    MaskArray,
    Photo,
)

# of the photograph's long side: tags of 20 px in 12 MP, where their bits are 2.5 px
MIN_PERIMETER_SHARE = 0.02
MAX_QUADS = 1000  # outlines that are looked at: a board of 250 tags has some 500 and their bits, which are smaller
# outlines in which all ten families are looked for: time grows with both
MAX_FOREIGN_QUADS = 250
# than the outlines of which there are too many: a cloth's squares are all alike
LONGER_THAN_ALIKE = 1.1
QUAD_WINDOW_PX = 13  # in which a place is darker than around it, in a photograph of half the size
# long side on which tags that were not announced are sought: they only explain a refusal
FOREIGN_SIDE_PX = 2016
MIN_TAGS = 4
MIN_ROWS_SPREAD = 0.25  # of a square: tags in one row spread by nothing, in two by half
# With so many points that spread so much, as a share of the whole board's spread along its narrower axis, corners that
# are 0.12 px off leave the distance right to 0.25 % and the slant to some degree, in nine of ten.
MIN_POINTS, MIN_SPREAD = 8, 0.4
# of a tag's side, from where the others put it; lenses and curled paper move it by less
MAX_STRAY_TAG = 0.2
# tags that are not where the announced board has them: so many, and as a share of those that are
MAX_STRAYS = (1, 0.1)
MAX_INK_GAIN = 0.02  # of a tag's side, at either end: more, and the print has other proportions
MIN_INK_GAIN_PX = 1.0  # as much as blur and a tone curve take off small tags
LARGEST_OF_FAMILY = (  # the smaller dictionaries are their first tags
    *(f"DICT_{bits}X{bits}_1000" for bits in (4, 5, 6, 7)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36H12",
    *(name for name in DICTIONARIES if "APRILTAG" in name),
)
SEE_MORE = "Uncover the marker: at least four of its tags, well apart, must be in the photograph and not in glare."
USE_ANNOUNCED = "Use the marker that the study printed, or announce the one that lies on the table."


@dataclass(frozen=True, slots=True)
class Tags:
    """Tags of one dictionary in a photograph. ids: (n,). corners_px: (n, 4, 2), clockwise from the upper left."""

    ids: Int64Array
    corners_px: Float64Array

    def __len__(self) -> int:
        """Number of tags."""
        return len(self.ids)

    def chosen(self, mask: MaskArray) -> "Tags":
        """Those where the mask (n,) holds."""
        return Tags(self.ids[mask], self.corners_px[mask])


def find_tag_board(photo: Photo, spec: TagBoard, where: str) -> MarkerObservation | Failure | None:
    """The announced board's points in view, or why they cannot be had; None where no tag at all is seen.

    Failures: marker_mismatch, marker_covered, image_too_dark, image_blurred. where: such as "in the left photograph".
    """
    grey = grey_of(photo.pixels_bgr)
    tags = _detect_tags(grey, spec.dictionary, _parameters(_least_perimeter_share(grey, MAX_QUADS)))
    on_board = tags.chosen(_placed(tags, spec))
    seen: MarkerObservation | Failure | None = _other_board(tags, len(on_board), spec, where)
    if seen is None and len(on_board) >= MIN_TAGS:
        seen = _read_board(grey, on_board, spec, where)
    if isinstance(seen, MarkerObservation):
        return seen
    unfit = judge_photograph(grey, where)
    if unfit is not None:
        return unfit
    if seen is None:
        seen = _foreign_tags(grey, spec, where)
    return _covered(len(on_board), where) if seen is None and len(on_board) else seen


def _read_board(
    grey: ImageArray, on_board: Tags, spec: TagBoard, where: str
) -> MarkerObservation | Failure:
    """The points of MIN_TAGS tags or more that lie where the announced board has them."""
    corners_mm = tag_corners_mm(spec)[on_board.ids]
    if _spread_mm(corners_mm.mean(axis=1)) < MIN_ROWS_SPREAD * spec.pitch_mm:
        return _covered(len(on_board), where)
    share = border_share(spec)
    refined = refine_tags(grey, on_board.corners_px, share)
    gain_px = ink_gain_px(refined, corners_mm)
    side_px = float(np.median(np.linalg.norm(refined[:, 1] - refined[:, 0], axis=-1)))
    if abs(gain_px) > max(MIN_INK_GAIN_PX, MAX_INK_GAIN * side_px):
        larger = "smaller" if gain_px > 0 else "larger"
        return mismatch(
            spec,
            where,
            f"a board whose tags are {larger} for their distances than the announced ones",
        )
    grown = Tags(on_board.ids, grow_tags(refined, gain_px))
    observation = (
        _tag_points(grown, spec) if spec.points_are_tags else _square_corners(grey, grown, spec)
    )
    if not _is_enough(observation):
        return _covered(len(on_board), where)
    unfit = judge_tags(grey, grown.corners_px, share, where)
    return observation if unfit is None else unfit


def _detect_tags(grey: ImageArray, name: str, parameters: cv2.aruco.DetectorParameters) -> Tags:
    """Tags of the named dictionary, each number once: where two tags have it, the larger one."""
    detector = cv2.aruco.ArucoDetector(_dictionary_of(name), parameters)
    corners, ids, _ = detector.detectMarkers(grey)
    return _largest(() if ids is None else np.ravel(ids), corners)


def _detect_of_any(grey: ImageArray, names: Sequence[str]) -> tuple[str, Tags]:
    """The dictionary of most of the tags that show their bits without an error, and its tags."""
    exact = _parameters(_least_perimeter_share(grey, MAX_FOREIGN_QUADS))
    exact.errorCorrectionRate = 0.0
    detector = cv2.aruco.ArucoDetector([_dictionary_of(name) for name in names], exact)
    corners, ids, _, of_dictionary = detector.detectMarkersMultiDict(grey)
    numbers, places = (
        np.ravel(each) if each is not None else np.empty(0, np.int64)
        for each in (ids, of_dictionary)
    )
    tags = [
        _largest(
            numbers[places == place],
            [quad for quad, own in zip(corners, places, strict=True) if own == place],
        )
        for place in range(len(names))
    ]
    return max(zip(names, tags, strict=True), key=lambda each: len(each[1]))


def _parameters(least_perimeter_share: float) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = least_perimeter_share
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return parameters


def _dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's, whose names of AprilTags have a capital H too."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _largest(ids: Iterable[int], corners: Iterable[cv2.typing.MatLike]) -> Tags:
    """Each number once, with the largest of its tags."""
    largest_tags: dict[int, Float64Array] = {}
    for number, quad in zip(ids, corners, strict=True):
        tag = np.asarray(quad, np.float64).reshape(4, 2)
        if int(number) not in largest_tags or np.ptp(tag) > np.ptp(largest_tags[int(number)]):
            largest_tags[int(number)] = tag
    numbers = sorted(largest_tags)
    return Tags(
        np.array(numbers, np.int64),
        np.array([largest_tags[number] for number in numbers]).reshape(-1, 4, 2),
    )


def _least_perimeter_share(grey: ImageArray, most: int) -> float:
    """Return the least perimeter, as a share of the long side, that leaves a photograph `most` quadrangles.

    The detector compares each with each: a chequered tablecloth of 9,000 squares would hold it for minutes.
    """
    image, _ = reduced(grey, max(grey.shape) // 2)
    dark = cv2.adaptiveThreshold(
        image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, QUAD_WINDOW_PX, 7
    )
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # The detector sees the same outlines in the whole photograph, where a perimeter may be some px longer.
    shares = (np.sort(list(map(len, contours)))[::-1] + 4.0) / max(image.shape)
    if len(shares) <= most:
        return MIN_PERIMETER_SHARE
    return max(MIN_PERIMETER_SHARE, LONGER_THAN_ALIKE * float(shares[most]))


def _placed(tags: Tags, spec: TagBoard, *, is_legacy: bool = False) -> MaskArray:
    """(n,) tags that lie where the announced board has them, seen through one homography."""
    layout = tag_corners_mm(spec, is_legacy=is_legacy)
    placed = tags.ids < len(layout)
    if not placed.any():
        return placed
    own = tags.chosen(placed)
    side_px = np.linalg.norm(own.corners_px - np.roll(own.corners_px, 1, axis=1), axis=-1).mean(
        axis=1
    )
    limit_px = MAX_STRAY_TAG * float(np.median(side_px))
    corners_mm = layout[own.ids].reshape(-1, 2)
    matrices = [
        cv2.findHomography(corners_mm, own.corners_px.reshape(-1, 2), cv2.RANSAC, limit_px)[0]
    ]
    homography = next(
        (np.asarray(matrix, np.float64) for matrix in matrices if matrix is not None), None
    )
    if homography is None:
        return np.zeros_like(placed)
    off = np.linalg.norm(
        map_points(homography, corners_mm).reshape(-1, 4, 2) - own.corners_px, axis=-1
    ).max(axis=1)
    placed[placed] = off < 2 * limit_px
    return placed


def _other_board(tags: Tags, on_board: int, spec: TagBoard, where: str) -> Failure | None:
    """Failure marker_mismatch where tags of the announced dictionary lie otherwise than on the announced board."""
    strays = len(tags) - on_board
    fewest, share = MAX_STRAYS
    if len(tags) < MIN_TAGS or strays <= max(fewest, share * on_board):
        return None
    on_legacy_board = np.count_nonzero(_placed(tags, spec, is_legacy=True))
    if on_legacy_board > max(on_board, strays):
        return mismatch(
            spec,
            where,
            "a ChArUco board of the pattern that OpenCV printed before version 4.6, whose upper left square is light,",
        )
    return mismatch(spec, where, f"another board of {len(tags)} tags of {spec.dictionary}")


def _foreign_tags(grey: ImageArray, spec: TagBoard, where: str) -> Failure | None:
    """Return the failure marker_mismatch where other dictionaries' tags or mirrored ones are seen."""
    fewer, _ = reduced(grey, FOREIGN_SIDE_PX)
    parameters = _parameters(_least_perimeter_share(fewer, MAX_QUADS))
    mirrored = _detect_tags(np.ascontiguousarray(fewer[:, ::-1]), spec.dictionary, parameters)
    if np.count_nonzero(_placed(mirrored, spec)) >= MIN_TAGS:
        return mismatch(spec, where, "its mirror image")
    name, tags = _detect_of_any(fewer, LARGEST_OF_FAMILY)
    if len(tags) < MIN_TAGS:
        return None
    return mismatch(
        spec, where, f"a board of {len(tags)} tags of another dictionary, {name} or a part of it,"
    )


def _tag_points(tags: Tags, spec: TagBoard) -> MarkerObservation:
    ids = (4 * tags.ids[:, None] + np.arange(4)).ravel()
    return MarkerObservation(spec, tags.corners_px.reshape(-1, 2), ids)


def _square_corners(grey: ImageArray, tags: Tags, spec: TagBoard) -> MarkerObservation:
    """The inner corners of a ChArUco board both of whose tags are seen, refined where four squares meet."""
    size = (spec.columns, spec.rows)
    board = cv2.aruco.CharucoBoard(
        size, spec.square_mm, spec.tag_mm, _dictionary_of(spec.dictionary)
    )
    quads = [quad.astype(np.float32).reshape(1, 4, 2) for quad in tags.corners_px]
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(
        grey, markerCorners=quads, markerIds=tags.ids.astype(np.int32).reshape(-1, 1)
    )
    numbers = np.array([] if len(corners) == 0 else np.ravel(ids), np.int64)
    order = np.argsort(numbers)
    return MarkerObservation(
        spec, np.array(corners, np.float64).reshape(-1, 2)[order], numbers[order]
    )


def _is_enough(observation: MarkerObservation) -> bool:
    """Whether what is seen tells scale and pose: so many points, spread over enough of the board."""
    whole = print_points_mm(observation.spec)
    seen = observation.seen_of(whole)
    return len(seen) >= min(MIN_POINTS, len(whole)) and _spread_mm(seen) >= MIN_SPREAD * _spread_mm(
        whole
    )


def _spread_mm(points: Float64Array) -> float:
    """Standard deviation of points (n, 2) along the axis where they spread least."""
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[0], 0.0)))


def _covered(tags: int, where: str) -> Failure:
    return Failure(
        "marker_covered",
        f"Too little of the marker can be seen {where}: {tags} of its tags, or one side alone.",
        SEE_MORE,
    )


def mismatch(spec: MarkerSpec, where: str, seen: str) -> Failure:
    """The failure of another board than the announced one."""
    return Failure(
        "marker_mismatch",
        f"The marker {spec} was announced, but {seen} is seen {where}.",
        USE_ANNOUNCED,
    )
