"""How unsure the focal length is where neither a calibration nor EXIF tells it, and what that does to volumes.

Seen from straight above, a board looks alike from near with a short lens and from afar with a long one. Its corners are
therefore fitted with one focal length after another: what they and the prior allow is the spread, however narrow the
minimum is in which the fit of all unknowns ended.
"""

from dataclasses import dataclass, replace

import numpy as np

from app.core.errors import Failure
from app.vision.board.pose import (
    CORNER_SD_PX_AT_12MP,
    FOCAL_SPREAD_UNKNOWN,
    LONG_SIDE_12MP,
    BoardFit,
    fit_board,
)
from app.vision.intrinsics import Camera
from app.vision.model import View

SCALES = np.exp(np.linspace(-0.6, 0.6, 25))  # of the focal length of a common phone
# a view: neighbouring corners share what lens and paper do beyond their models
INDEPENDENT_CORNERS = 12.0
FLAG_SD = 0.05  # of a volume, relative, from which on the unknown focal length is named
MOST_SD = 0.25  # beyond, a 90 % interval spans more than a factor of two; what fills a bowl has the same limit


@dataclass(frozen=True, slots=True)
class FocalDoubt:
    """log_sd: relative spread of the focal length. own: the views that fit with the one found; moved: a spread away."""

    log_sd: float
    own: tuple[View, View]
    moved: tuple[View, View]


def doubt_focal(first: View, second: View, guess: Camera) -> FocalDoubt | None:
    """None where a calibration or EXIF tells the focal length. guess: a common phone's camera for these photographs."""
    if first.camera.source != "board" or second.camera.source != "board":
        return None
    fits = [(scale, _fit(first, second, guess, float(scale))) for scale in SCALES]
    possible = [
        (float(np.log(scale)), _cost(fit, first, float(np.log(scale))))
        for scale, fit in fits
        if fit is not None
    ]
    if len(possible) < 2:
        return None
    logs, costs = np.array(possible).T
    weights = np.exp(-0.5 * (costs - costs.min()))
    weights /= weights.sum()
    mean = float(weights @ logs)
    step = float(np.diff(np.log(SCALES))[0])
    log_sd = float(np.sqrt(weights @ (logs - mean) ** 2 + step**2 / 12.0))
    fitted_log = float(np.log(first.camera.fx / guess.fx))
    towards = -1.0 if fitted_log > mean else 1.0  # to where the rest of what the board allows lies
    own = _fit(first, second, guess, float(np.exp(fitted_log)))
    moved = _fit(
        first,
        second,
        guess,
        float(np.exp(fitted_log + towards * max(log_sd, abs(fitted_log - mean)))),
    )
    if own is None or moved is None:
        return None
    return FocalDoubt(
        log_sd, *((_placed(first, fit, 0), _placed(second, fit, 1)) for fit in (own, moved))
    )


def too_unsure() -> Failure:
    """The failure where the focal length leaves volumes open by more than anybody could use."""
    return Failure(
        "focal_unknown",
        "The photographs do not say with which focal length they were taken, and seen from straight above the marker "
        "cannot tell it either.",
        "Send the photographs with their EXIF data, or a camera calibration, or photograph the meal at a slant of "
        "about 45 degrees.",
    )


def _fit(first: View, second: View, guess: Camera, scale: float) -> BoardFit | None:
    camera = replace(guess, fx=guess.fx * scale, fy=guess.fy * scale, source="given")
    return fit_board((camera, camera), (first.required_marker, second.required_marker))


def _cost(fit: BoardFit, view: View, log_scale: float) -> float:
    """-2 log of the posterior of one focal length, up to a constant."""
    sd_px = CORNER_SD_PX_AT_12MP * max(view.camera.width, view.camera.height) / LONG_SIDE_12MP
    misfit = INDEPENDENT_CORNERS * float(np.square(fit.rms_px).sum()) / sd_px**2
    return misfit + float(np.square(fit.bend_mm).sum()) + (log_scale / FOCAL_SPREAD_UNKNOWN) ** 2


def _placed(view: View, fit: BoardFit, index: int) -> View:
    rotation, translation_mm = fit.poses[index]
    return replace(
        view, camera=fit.cameras[index], rotation=rotation, translation_mm=translation_mm
    )
