"""Cameras and rigs with the keys of their files, as vision/intrinsics.py and vision/rig.py read them."""

from app.meals.stored.run_answer import Json
from app.vision.intrinsics import Camera
from app.vision.rig import StereoRig


def camera_to_json(camera: Camera) -> Json:
    """A camera with the keys of a camera file."""
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": list(camera.distortion),
        "source": camera.source,
    }


def rig_to_json(rig: StereoRig) -> Json:
    """A rig with the keys of a rig file; each camera with its own size."""
    return {
        "left": camera_to_json(rig.left),
        "right": camera_to_json(rig.right),
        "R": [list(row) for row in rig.rotation],
        "t_mm": list(rig.translation_mm),
    }
