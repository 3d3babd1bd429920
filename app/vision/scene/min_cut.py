"""A two-label minimum cut on the pixel grid with given data terms, contrast-sensitive (Boykov and Jolly, 2001).

Log-likelihood ratios and two feature channels -> the mask of least energy. OpenCV's GrabCut is the solver: its colour
models are frozen to two equal Gaussians along a first channel that carries the ratios, so that its data term is ours.
"""

import cv2
import numpy as np

from app.vision.model import Float32Array, ImageArray, MaskArray
from app.vision.tuning import COLOUR_TUNING

LEVELS = 80  # steps of the channel that carries the ratios
LIMIT_NATS = 10.0  # ratios beyond are as good as certain
WIDE = 1e6  # variance that makes the feature channels mute in the data term


def cut_in_two(
    ratio_nats: Float32Array, features: ImageArray, is_never: MaskArray, is_always: MaskArray
) -> MaskArray:
    """(H, W) where the first label wins.

    ratio_nats: (H, W) log likelihood of the first label over the second. features: (H, W, 2) uint8, whose contrast
    invites the border. is_never, is_always: (H, W) fixed pixels; never goes before always.
    """
    half = LEVELS / 2
    variance = LEVELS * half / LIMIT_NATS  # so that a step of one level is LIMIT_NATS / half
    # A channel of smaller span would weigh less in the contrast; it is the same for both Gaussians either way.
    carried = np.clip(np.rint(half + ratio_nats * half / LIMIT_NATS), 0, LEVELS) / 4
    labels = np.where(ratio_nats > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[is_always] = cv2.GC_FGD
    labels[is_never] = cv2.GC_BGD
    has_first = bool(((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).any())
    has_second = bool(((labels == cv2.GC_BGD) | (labels == cv2.GC_PR_BGD)).any())
    if not (has_first and has_second):
        return np.full(labels.shape, has_first, np.bool_)
    image = np.dstack([carried.astype(np.uint8), features])
    cv2.grabCut(
        image,
        labels,
        (0, 0, 1, 1),
        _model(0.0, variance / 16),
        _model(LEVELS / 4, variance / 16),
        1,
        cv2.GC_EVAL_FREEZE_MODEL,
    )
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD), np.bool_)


def is_settled(mask: MaskArray, before: MaskArray) -> bool:
    """Return whether a cut, (h, w), hardly differs from the one before."""
    changed = np.count_nonzero(mask ^ before)
    return bool(changed <= COLOUR_TUNING.settled * np.count_nonzero(mask))


def _model(mean: float, variance: float) -> np.ndarray:
    """One Gaussian in GrabCut's layout: five weights, five means, five covariances."""
    model = np.zeros((1, 65))
    model[0, 0] = 1.0
    model[0, 5:8] = [mean, 128.0, 128.0]
    model[0, 20:29] = np.diag([variance, WIDE, WIDE]).ravel()
    return model
