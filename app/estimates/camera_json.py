"""A camera with the keys of a camera file: what `camera_from_mapping` of vision/intrinsics.py reads."""

from app.meals.run_answer import Json
from app.vision.intrinsics import Camera


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
