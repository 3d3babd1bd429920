"""A rendered scene's two cameras as a stereo rig."""

import numpy as np

from app.vision.rig import StereoRig


def rig_of(left, right) -> StereoRig:
    """Cameras and relative pose of two views."""
    rotation = right.rotation @ left.rotation.T
    translation_mm = right.translation_mm - rotation @ left.translation_mm
    rows = tuple(tuple(float(value) for value in row) for row in np.round(rotation, 8))
    return StereoRig(left.camera, right.camera, rows, tuple(float(value) for value in translation_mm))
