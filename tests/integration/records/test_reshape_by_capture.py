"""However a meal's scale was found, its item can be given a form by hand where the run's scene shows the food."""

import json
import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest

from app.meals.estimate.run_estimate import estimate_task
from app.vision.intrinsics import camera_to_json
from app.vision.rig import rig_to_json
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.measuring import estimate
from tests.integration.records.reviewing import Speaker
from tests.support.depth_maps import depth_png
from tests.unit.vision.poses import arkit_poses
from tests.unit.vision.rigs import rig_of
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views, true_depth
from tests.unit.vision.test_pipeline_of_one import on_plain_table

pytestmark = pytest.mark.slow

BALL = Ball((115.0, 15.0), 33.0)
MIDDLE_MM = np.array([*BALL.centre_mm, BALL.radius_mm])
DEPTH_SIZE = (256, 192)


@dataclass(frozen=True)
class Capture:
    """A phone's photographs and metadata, and how far the volume of a ball may then be off."""

    source: str
    photographs: dict
    volume_off: float
    metadata: dict = field(default_factory=dict)


def by_rig():
    views = rendered_views(BALL)
    return Capture("rig", of_pair(views), 0.06, {"rig": json.loads(json.dumps(rig_to_json(rig_of(*views))))})


def by_poses():
    views = rendered_views(BALL)
    return Capture("poses", of_pair(views), 0.08, {"poses": arkit_poses(*views), "camera": camera_to_json(CAMERA)})


def by_depth():
    view = rendered_views(BALL)[0]
    shrink = DEPTH_SIZE[0] / CAMERA.width
    focal = CAMERA.fx * shrink
    centre = ((CAMERA.cx + 0.5) * shrink - 0.5, (CAMERA.cy + 0.5) * shrink - 0.5)
    depth_mm = true_depth(view.rotation, view.centre_mm, focal, centre, DEPTH_SIZE[::-1], BALL)
    camera = {"width": DEPTH_SIZE[0], "height": DEPTH_SIZE[1], "fx": focal, "fy": focal, "cx": centre[0]}
    metadata = {"views": 1, "camera": camera_to_json(CAMERA), "depth_camera": camera | {"cy": centre[1]}}
    photographs = {"left": jpeg(on_plain_table(view.photo)), "left_depth": depth_png(depth_mm=depth_mm)}
    return Capture("depth", photographs, 0.12, metadata)


def by_one_photograph():
    photographs = {"left": jpeg(on_plain_table(rendered_views(BALL)[0].photo))}
    metadata = {"views": 1, "camera": camera_to_json(CAMERA), "marker": str(SPEC)}
    return Capture("marker", photographs, 0.25, metadata)


def of_pair(views):
    return {side: jpeg(view.photo) for side, view in zip(("left", "right"), views, strict=True)}


def jpeg(photo):
    return cv2.imencode(".jpg", photo.pixels_bgr, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def pixel_of(place_mm, camera, rotation, translation_mm):
    x, y, z = np.array(rotation) @ place_mm + translation_mm
    return camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]


@pytest.mark.parametrize("capture", [by_rig, by_poses, by_depth, by_one_photograph])
def test_form_around_the_food_in_the_scene_has_its_place_and_volume(enrol, state, settings, client, admin, capture):
    sent = capture()
    view = rendered_views(BALL)[0]
    middle_px = pixel_of(MIDDLE_MM, camera_to_json(CAMERA), view.rotation, view.translation_mm)
    phone = enrol(marker=None)
    body = meal_metadata(hints=[{"point": list(middle_px), "food": "orange"}], **sent.metadata)
    answer = phone.post(sent.photographs, metadata=body)
    assert answer.status_code == 202, answer.text
    estimate(state, settings, body["id"], run=estimate_task)

    scene = phone.get(f"/v1/meals/{body['id']}/artefacts/scene.json").json()
    assert scene["scale_source"] == sent.source
    assert ("board" in scene) == (sent.source == "marker")
    (food,) = [item for item in scene["items"] if item["hint"] == 0]
    size_mm = food["size_mm"]
    box = food["shape"]["vertices"]
    x, y = (box["offset"][axis] for axis in (0, 1))  # half way between the least and the greatest
    form = {"section": "ellipsoid", "centre_mm": [x, y], "base_mm": food["support_mm"], "yaw_deg": 0.0}
    form |= {"length_mm": size_mm["width"], "width_mm": size_mm["depth"], "height_mm": size_mm["height"]}
    camera = scene["photographs"]["left"]["camera"]
    middle_mm = np.array([x, y, food["support_mm"] + size_mm["height"] / 2])
    seen_px = pixel_of(middle_mm, camera, camera["rotation"], camera["translation_mm"])
    assert math.dist(seen_px, middle_px) < 8.0  # of a ball of 190 px
    assert camera["centre_mm"][2] == pytest.approx(view.centre_mm[2], rel=0.03)  # over the table, z = 0

    reviewer = Speaker(client, admin, body["id"])
    item = reviewer.items()[food["index"]]
    assert item["volume_ml"] == pytest.approx(food["volume_ml"], abs=0.001)
    reshaped = reviewer.say("reshape", item=item["id"], form=form)["items"][food["index"]]
    assert reshaped["volume_ml"] == pytest.approx(math.pi / 6 * math.prod(size_mm.values()) / 1000)
    assert reshaped["volume_ml"] == pytest.approx(BALL.volume_ml, rel=sent.volume_off)
