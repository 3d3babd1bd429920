"""The printed checkerboard in a photograph: is it there, and which of its corners is which.

Photo and announced marker in -> inner corners in the print's own order (CONVENTIONS.md), or a Failure that tells what
is seen instead. A plain board that looks the same when turned is read in any of its ways; agree_on_corners then makes
the two views of a pair read it in the same way.
"""

from dataclasses import replace
from typing import Literal

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif
from app.vision.board.grid import alternating_share, grid_homography, refine_grid, square_means
from app.vision.board.pose import solve_pose
from app.vision.board.quality import judge_marker, judge_photograph
from app.vision.board.search import find_grids
from app.vision.board.tag_board import find_tag_board, mismatch
from app.vision.geometry.pictures import grey_of
from app.vision.marker_spec import Colour, MarkerSpec, TagBoard
from app.vision.model import Float64Array, ImageArray, MarkerObservation, Photo, PhotoPair

Side = Literal["left", "right"]

# of neighbouring squares that must step from dark to light as the print does
MIN_CORRECT_SHARE = 0.9
CLEAR_ANGLE_DEG = 10.0  # between camera directions of two readings; focal length and bent paper move one by some 3
CLEAR_CORRELATION = 0.1  # between two readings' surroundings; bare tables differ by less, textured ones by 0.3 and more
SURROUNDINGS_SQUARES = 4  # of table around the board that are compared
SURROUNDINGS_PX = 12  # a square
MIN_CHROMA = 0.2  # mean over the dark squares, of white's level; the colour board has 0.5, a black and white one 0.05
# mean over squares and channels, of white's level; light and white balance move it by 0.1
MAX_COLOUR_DISTANCE = 0.25
WHITE: Colour = (255, 255, 255)
COLOUR_TONE = 1.5  # exponent on grey levels before corners are refined, see _refinement_image

SEE_WHOLE = "Check that the whole printed marker, with its white margin, is visible and not in glare, and try again."


def find_marker(
    photo: Photo, spec: MarkerSpec, side: Side | None = None
) -> MarkerObservation | Failure:
    """The announced board's points in view, or why they cannot be had. A checkerboard must be seen as a whole.

    Failures: marker_not_found, marker_mismatch, marker_covered, image_too_dark, image_blurred. side names the
    photograph in messages.
    """
    where = f"in the {side} photograph" if side else "in the photograph"
    if isinstance(spec, TagBoard):
        seen = find_tag_board(photo, spec, where)
        return _explain_absence(photo.pixels_bgr, spec, where) if seen is None else seen
    contrast = contrast_image(photo.pixels_bgr, is_coloured=spec.is_coloured)
    corners = (spec.columns - 1, spec.rows - 1)
    refusal: Failure | None = None
    whole_boards: list[set[int]] = []
    for grid in find_grids(contrast, corners):
        shape = set(grid.shape[:2])
        if shape != set(corners):
            if has_white_margin(contrast, grid):
                refusal = _other_size(spec, grid, where)
                # read in the same way twice: no other effort would tell another size
                if shape in whole_boards:
                    break
                whole_boards.append(shape)
            continue
        read = _read_grid(photo.pixels_bgr, contrast, grid, spec, where)
        if isinstance(read, MarkerObservation):
            unfit = judge_marker(contrast, read.grid_px, where)
            return read if unfit is None else unfit
        refusal = read if refusal is None else refusal
    unfit = judge_photograph(grey_of(photo.pixels_bgr), where)  # squares are misread in the dark
    if unfit is not None:
        return unfit
    return _explain_absence(photo.pixels_bgr, spec, where) if refusal is None else refusal


def readings(observation: MarkerObservation) -> list[MarkerObservation]:
    """All the ways to read the same corners that the board's looks cannot tell apart, the given one first.

    A plain board whose sides add up to an even number looks the same turned by 180 degrees; one with as many rows as
    columns, odd, by 90 degrees too. Tags are numbered, so that their boards have one way.
    """
    spec = observation.spec
    if isinstance(spec, TagBoard):
        return [observation]
    grid = observation.grid_px
    colours = [spec.square_colour(square) or WHITE for square in spec.squares]
    looks = np.array(colours).reshape(spec.rows, spec.columns, 3)
    turns = [turn for turn in range(4) if np.array_equal(np.rot90(looks, turn), looks)]
    return [MarkerObservation(spec, np.rot90(grid, turn).reshape(-1, 2).copy()) for turn in turns]


def agree_on_corners(
    pair: PhotoPair, left: MarkerObservation, right: MarkerObservation
) -> tuple[MarkerObservation, MarkerObservation]:
    """Both observations with the same corner first, where the board's looks leave a choice (see readings).

    A reading of the right view that is turned against the left one would put the right camera on the other side of the
    marker, so that the nearest camera direction decides, whichever way the phone was rolled. Where both looked down so
    steeply that directions cannot tell, what lies around the marker does; where nothing lies there, the smaller roll.
    """
    ways = readings(right)
    if len(ways) == 1:
        return left, right
    left_photo, right_photo = pair.both
    left_pose = _rough_pose(left_photo, left)
    poses = [_rough_pose(right_photo, way) for way in ways]
    if left_pose is None or any(pose is None for pose in poses):
        return left, right
    rotations = [pose for pose in poses if pose is not None]
    angles = [_angle_deg(float(left_pose[1] @ direction)) for _, direction in rotations]
    nearest, second = np.argsort(angles)[:2]
    if angles[second] - angles[nearest] > CLEAR_ANGLE_DEG and angles[second] > 2 * angles[nearest]:
        return left, ways[nearest]
    surroundings = _rectify_surroundings(left_photo, left)
    likeness = [_correlation(surroundings, _rectify_surroundings(right_photo, way)) for way in ways]
    runner_up, likest = np.argsort(likeness)[-2:]
    if likeness[likest] - likeness[runner_up] > CLEAR_CORRELATION:
        return left, ways[likest]
    turns = [_angle_deg((np.trace(left_pose[0].T @ rotation) - 1) / 2) for rotation, _ in rotations]
    return left, ways[int(np.argmin(turns))]


def _rough_pose(
    photo: Photo, observation: MarkerObservation
) -> tuple[Float64Array, Float64Array] | None:
    """Rotation (3, 3) and the (3,) unit vector from the board's middle to a camera of about this focal length."""
    solved = solve_pose(camera_from_exif(photo), observation)
    if solved is None:
        return None
    centre = -solved[0].T @ solved[1]
    return solved[0], centre / np.linalg.norm(centre)


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _rectify_surroundings(photo: Photo, observation: MarkerObservation) -> Float64Array:
    """The table around the marker seen from above, grey, local mean removed; NaN on the sheet and outside the photo.

    (k, k): SURROUNDINGS_SQUARES squares beyond the board's longer side, SURROUNDINGS_PX px a square.
    """
    spec = observation.spec
    reach = max(spec.columns, spec.rows) / 2 + SURROUNDINGS_SQUARES
    size = int(2 * reach * SURROUNDINGS_PX)
    fitted = grid_homography(observation.grid_px)
    if fitted is None:
        return np.full((size, size), np.nan)
    # px of the rectified picture -> (column, row) of inner corners -> px of the photograph
    middle = np.array([spec.columns / 2 - 1, spec.rows / 2 - 1])
    to_index = np.array(
        [
            [1 / SURROUNDINGS_PX, 0, middle[0] - reach],
            [0, 1 / SURROUNDINGS_PX, middle[1] - reach],
            [0, 0, 1],
        ]
    )
    grey = cv2.cvtColor(photo.pixels_bgr, cv2.COLOR_BGR2GRAY)
    to_photo, window = fitted[0] @ to_index, (2 * SURROUNDINGS_PX + 1, 2 * SURROUNDINGS_PX + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(grey, to_photo, (size, size), flags=flags).astype(np.float64)
    inside = cv2.warpPerspective(np.ones_like(grey), to_photo, (size, size), flags=flags).astype(
        np.float64
    )
    detail = seen - cv2.blur(seen, window)
    detail[cv2.blur(inside, window) < 1.0] = np.nan
    from_middle = np.abs((np.arange(size) + 0.5) / SURROUNDINGS_PX - reach)
    sheet_x, sheet_y = (from_middle < side / 2 + 1.5 for side in (spec.columns, spec.rows))
    detail[np.outer(sheet_y, sheet_x)] = np.nan
    return detail


def _correlation(a: Float64Array, b: Float64Array) -> float:
    """Correlation over what both have; -1 if that is too little to say."""
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < a.size / 50:
        return -1.0
    return float(np.nan_to_num(np.corrcoef(a[both], b[both])[0, 1], nan=-1.0))


def contrast_image(pixels_bgr: ImageArray, *, is_coloured: bool) -> ImageArray:
    """(H, W): grey for a black board; for a coloured one the smallest channel, in which white alone is light."""
    if not is_coloured:
        return grey_of(pixels_bgr)
    blue, green, red = cv2.split(pixels_bgr)
    return np.asarray(cv2.min(cv2.min(blue, green), red), np.uint8)


def _refinement_image(contrast: ImageArray, *, is_coloured: bool) -> ImageArray | np.ndarray:
    """The image whose edges are where the print's edges are.

    Blur happens in linear light, so that in the camera's tone curve a dark square looks smaller. Where two equal
    squares meet this cancels, not where a yellow one meets a black one. Straight to linear light would overdo it,
    since cameras sharpen after the tone curve: the exponent lies between 1 and 2.2.
    """
    if not is_coloured:
        return contrast
    table = (255.0 * (np.arange(256) / 255.0) ** COLOUR_TONE).astype(np.float32)
    return np.asarray(table[contrast])


def _read_grid(
    pixels_bgr: ImageArray, contrast: ImageArray, grid: Float64Array, spec: MarkerSpec, where: str
) -> MarkerObservation | Failure:
    """Refined corners in the print's order, or Failure marker_mismatch: colours or size are another board's."""
    right = [
        turned
        for turned in _turns(grid, spec)
        if _correct_share(contrast, turned, spec.first_is_dark) >= MIN_CORRECT_SHARE
    ]
    if not right:
        return mismatch(
            spec, where, "a board whose dark squares are where the announced one has light ones"
        )
    # Of several possible ways the one whose rows follow each other downwards in the photograph.
    chosen = max(right, key=lambda turned: float((turned[-1, :, 1] - turned[0, :, 1]).sum()))
    means_bgr = square_means(pixels_bgr, chosen)
    is_coloured = _dark_square_chroma(means_bgr, spec.first_is_dark) > MIN_CHROMA
    if is_coloured and not spec.is_coloured:
        return mismatch(spec, where, "a board with coloured squares")
    if spec.is_coloured and not (is_coloured and _shows_colours(means_bgr, spec)):
        return mismatch(spec, where, "a board of the same size with other colours")
    refined = refine_grid(_refinement_image(contrast, is_coloured=spec.is_coloured), chosen)
    return MarkerObservation(spec, refined.reshape(-1, 2))


def _dark_square_chroma(means_bgr: Float64Array, first_is_dark: bool) -> float:
    """Mean of (largest - smallest channel) over the dark squares, white squares made neutral, white = 1.

    means_bgr: (rows, columns, 3), grey levels.
    """
    dark = (np.indices(means_bgr.shape[:2]).sum(axis=0) % 2 == 0) == first_is_dark
    relative = means_bgr[dark] / _white_level(means_bgr, ~dark)
    return float(np.mean(relative.max(axis=1) - relative.min(axis=1)))


def _shows_colours(means_bgr: Float64Array, spec: MarkerSpec) -> bool:
    """Whether (rows, columns, 3) mean grey levels, read the right way up, show the board's colours in their places."""
    places = np.array(list(spec.colours))
    expected = np.array(list(spec.colours.values()), np.float64)[:, ::-1] / 255.0
    light = np.ones(means_bgr.shape[:2], bool)
    light[tuple(places.T)] = False
    measured = means_bgr[tuple(places.T)] / _white_level(means_bgr, light)
    return bool(np.mean(np.abs(measured - expected)) < MAX_COLOUR_DISTANCE)


def _white_level(means_bgr: Float64Array, light: np.ndarray) -> Float64Array:
    """(3,) median of the white squares, at least one grey level."""
    return np.asarray(np.maximum(np.median(means_bgr[light], axis=0), 1.0), np.float64)


def _turns(grid: Float64Array, spec: MarkerSpec) -> list[Float64Array]:
    """The grid turned to (rows - 1, columns - 1) corners in every way that does not mirror the print."""
    across, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    x, y = across.mean(axis=0), down.mean(axis=0)
    upright = grid if x[0] * y[1] - x[1] * y[0] > 0 else grid[:, ::-1]
    turned = (np.rot90(upright, turn) for turn in range(4))
    return [way for way in turned if way.shape[:2] == (spec.rows - 1, spec.columns - 1)]


def _correct_share(contrast: ImageArray, grid: Float64Array, first_is_dark: bool) -> float:
    share = alternating_share(square_means(contrast, grid))
    return share if first_is_dark else 1.0 - share


def has_white_margin(contrast: ImageArray, grid: Float64Array) -> bool:
    """Whether all around the grid's outermost squares the paper is as light as the light squares: a whole board."""
    means = square_means(contrast, grid, ring=1)
    inner = means[1:-1, 1:-1]
    middle = (np.percentile(inner, 25) + np.percentile(inner, 75)) / 2
    margin = np.concatenate([means[0, 1:-1], means[-1, 1:-1], means[1:-1, 0], means[1:-1, -1]])
    return bool(np.mean(margin > middle) >= MIN_CORRECT_SHARE)


def _explain_absence(pixels_bgr: ImageArray, spec: MarkerSpec, where: str) -> Failure:
    """Why the announced board was not found: another board, a covered one, or none."""
    contrast = contrast_image(pixels_bgr, is_coloured=True)  # white alone is light, on any board
    covered: Failure | None = None
    for grid in find_grids(contrast):
        rows, columns = (n + 1 for n in grid.shape[:2])
        if has_white_margin(contrast, grid):
            if isinstance(spec, TagBoard):
                board = f"a board of {columns}x{rows} squares without tags that could be read"
                return mismatch(spec, where, board)
            if {rows, columns} == {spec.rows, spec.columns}:
                return mismatch(spec, where, "a board of the same size with other colours")
            return _other_size(spec, grid, where)
        if covered is None and not isinstance(spec, TagBoard):
            covered = Failure(
                "marker_covered",
                f"Only a part of the marker, {columns}x{rows} of its squares, can be seen {where}.",
                "Nothing may lie on the marker, and all of it must be in the photograph, with its white margin.",
            )
    if covered is not None:
        return covered
    return Failure("marker_not_found", f"The marker {spec} was not found {where}.", SEE_WHOLE)


def _other_size(spec: MarkerSpec, grid: Float64Array, where: str) -> Failure:
    """Failure marker_mismatch of a whole board, (r, c, 2) inner corners, that has not the announced squares."""
    few, many = sorted(n + 1 for n in grid.shape[:2])
    columns, rows = (many, few) if spec.columns >= spec.rows else (few, many)
    if (columns - 1, rows - 1) == (spec.columns, spec.rows):
        return Failure(
            "marker_mismatch",
            f"A board of {columns}x{rows} squares is seen {where}, {spec.columns}x{spec.rows} were announced: "
            "count squares, not inner corners.",
            f"Announce {replace(spec, columns=columns, rows=rows)} if its squares are {spec.square_mm:g} mm wide.",
        )
    return mismatch(spec, where, f"a board of {columns}x{rows} squares")
