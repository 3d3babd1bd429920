"""Depth and confidence maps beside a meal's photographs: announced, checked, kept, given to the estimate, given out."""

import io
import struct
import zipfile
import zlib

import numpy as np

from app.children.child_pool import ChildPool, ChildResult
from app.meals.stored.models import MealImage
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.meals.upload.measuring import estimate
from tests.support.depth_maps import CAMERA, confidence_png, depth_png, depth_tiff, png, table_mm
from tests.support.photographs import pair, photograph

ALL = ["left_depth", "right_depth", "left_confidence"]


def with_depth(seed=0, **more):
    return pair(seed) | {"left_depth": depth_png(seed)} | more


def test_meal_waits_for_the_maps_that_it_announced_and_takes_each_again(phone):
    metadata = meal_metadata(depth_camera=CAMERA, depth_maps=ALL)
    path = f"/v1/meals/{metadata.pop('id')}"
    assert phone.put(path, json=metadata).json()["missing"] == ["left", "right", *ALL]
    parts = with_depth(right_depth=depth_tiff(), left_confidence=confidence_png())
    for slot in ("left", "right", "left_depth", "left_confidence"):
        sent = phone.put(f"{path}/images/{slot}", content=parts[slot])
        assert (sent.status_code, sent.json()["status"]) == (202, "receiving")
    assert phone.put(f"{path}/images/left_depth", content=parts["left_depth"]).status_code == 200
    assert refusal(phone.put(f"{path}/images/left_depth", content=depth_png(9))) == (409, "meal_id_reused")
    after = phone.put(f"{path}/images/after_left", content=photograph(10))  # completes no meal
    assert (after.status_code, after.json()["status"]) == (202, "receiving")
    tiff = {"Content-Type": "image/tiff"}
    sent = phone.put(f"{path}/images/right_depth", content=parts["right_depth"], headers=tiff)
    assert (sent.status_code, sent.json()["status"], sent.json()["missing"]) == (202, "queued", [])


def test_impossible_announcement_is_refused(phone):
    for changes in (
        {"depth_maps": ["left_depth"]},
        {"depth_camera": CAMERA | {"fx": 0}},
        {"depth_camera": {"width": 64}},
        {"depth_camera": CAMERA, "depth_maps": ["left_confidence"]},
        {"depth_camera": CAMERA, "depth_maps": ["view3_depth"]},
        {"depth_camera": CAMERA, "depth_maps": ["right_depth"], "views": 1},
    ):
        metadata = meal_metadata(**changes)
        path = f"/v1/meals/{metadata.pop('id')}"
        assert phone.put(path, json=metadata).json()["code"] == "metadata_invalid", changes
    for changes in ({"fx": 1500.0}, {"fy": 1e-300}, {"cx": -100000.0}, {"cy": 49.0}):  # of another picture
        sent = phone.post(with_depth(), depth_camera=CAMERA | changes)
        assert refusal(sent) == (422, "depth_camera_invalid"), changes


def tiff_of(pixels):
    """An uncompressed TIFF of one strip."""
    kind = 3 if pixels.dtype.kind == "f" else 1
    height, width = pixels.shape
    entries = [(256, width), (257, height), (258, 8 * pixels.itemsize), (259, 1), (262, 1), (273, 8)]
    entries += [(277, 1), (278, height), (279, pixels.nbytes), (339, kind)]
    directory = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", tag, 4, 1, n) for tag, n in entries)
    return b"II*\0" + struct.pack("<I", 8 + pixels.nbytes) + pixels.tobytes() + directory + bytes(4)


BAD_MAPS = {
    "photograph": (photograph(), "depth_unreadable"),
    "8 bits": (confidence_png(), "depth_unreadable"),
    "colours": (png(np.zeros((48, 64, 3), np.uint16)), "depth_unreadable"),
    "cut PNG": (depth_png()[:-30], "depth_unreadable"),
    "cut TIFF": (depth_tiff()[:-200], "depth_unreadable"),
    "TIFF of doubles": (tiff_of(table_mm()), "depth_unreadable"),
    "TIFF of whole numbers": (tiff_of(table_mm().astype(np.uint32)), "depth_unreadable"),
    "other size": (depth_png(size=(48, 64)), "depth_mismatch"),
}


def test_bad_map_is_refused_by_its_header_and_nothing_is_kept(phone, state):
    for name, (content, code) in BAD_MAPS.items():
        sent = phone.post(pair() | {"left_depth": content}, depth_camera=CAMERA)
        assert (*refusal(sent), sent.json()["slot"]) == (422, code, "left_depth"), name
    vast = png(np.zeros((2500, 4000), np.uint16))
    sent = phone.post(pair() | {"left_depth": vast}, depth_camera=CAMERA)
    assert refusal(sent) == (413, "image_too_many_pixels")
    both = {"depth_camera": CAMERA, "depth_maps": ["left_depth", "left_confidence"]}
    sent = phone.post(with_depth(left_confidence=depth_png()), **both)
    assert (*refusal(sent), sent.json()["slot"]) == (422, "depth_unreadable", "left_confidence")
    sent = phone.post(pair(), depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["parts"]) == (400, ["left_depth"])
    for parts, changes in ((with_depth(), {}), (with_depth(right_depth=depth_png()), {"depth_camera": CAMERA})):
        assert refusal(phone.post(parts, **changes)) == (422, "view_not_announced")
    with state.database.read() as session:
        assert session.query(MealImage).count() == 0


def with_other_pixels(content, pixels):
    """The PNG with other bytes for its pixels, and the checksum of these."""
    start = content.index(b"IDAT")
    chunk = b"IDAT" + pixels
    length, checksum = struct.pack(">I", len(pixels)), struct.pack(">I", zlib.crc32(chunk))
    return content[: start - 4] + length + chunk + checksum + content[content.index(b"IEND") - 4 :]


def test_map_that_is_empty_or_cannot_be_decoded_is_refused_by_a_child(phone):
    empty = png(np.zeros((48, 64), np.uint16))
    for content, code in ((empty, "depth_empty"), (with_other_pixels(depth_png(), b"nothing"), "depth_unreadable")):
        sent = phone.post(pair() | {"left_depth": content}, depth_camera=CAMERA)
        assert (sent.status_code, sent.json()["code"], sent.json()["slot"]) == (422, code, "left_depth")
    assert phone.post(with_depth(), depth_camera=CAMERA).status_code == 202


def test_map_that_breaks_the_child_is_refused(phone, monkeypatch):
    metadata = meal_metadata(depth_camera=CAMERA, depth_maps=["left_depth"])
    path = f"/v1/meals/{metadata.pop('id')}"
    phone.put(path, json=metadata)
    monkeypatch.setattr(ChildPool, "run", lambda *_, **__: ChildResult("out_of_memory"))
    sent = phone.put(f"{path}/images/left_depth", content=depth_png())
    assert (*refusal(sent), sent.json()["slot"]) == (422, "depth_unreadable", "left_depth")
    assert "left depth map" in sent.json()["detail"]


def test_estimate_is_given_the_maps_and_their_camera(phone, state, settings):
    parts = with_depth(right_depth=depth_tiff(), left_confidence=confidence_png())
    sent = phone.post(parts, depth_camera=CAMERA, depth_maps=ALL)
    children = estimate(state, settings, sent.json()["id"])
    assert children.maps == {
        "left depth": parts["left_depth"],
        "left confidence": parts["left_confidence"],
        "right depth": parts["right_depth"],
    }
    assert children.depths["left"]["camera"] == CAMERA


def test_meal_of_a_study_without_a_marker_needs_a_depth_map_of_the_left_photograph(enrol, state, settings):
    phone = enrol("P001", "bare", marker=None)
    alone = {"left": photograph()}
    assert refusal(phone.post(alone, marker=None, views=1)) == (422, "marker_missing")
    sent = phone.post(alone | {"left_depth": depth_png()}, marker=None, views=1, depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")
    assert estimate(state, settings, sent.json()["id"]).options["marker"] is None


def test_map_in_one_request_is_kept_given_out_exported_and_listed_as_it_is_stored(phone, client, admin):
    parts = with_depth()
    meal = phone.post(parts, depth_camera=CAMERA).json()
    client_id = meal["id"]
    assert (meal["status"], list(meal["images"]), meal["missing"]) == ("queued", ["left", "right", "left_depth"], [])
    image = meal["images"]["left_depth"]
    assert (image["media_type"], image["width_px"], image["height_px"], image["durable"]) == ("image/png", 64, 48, True)
    served = phone.get(f"/v1/meals/{client_id}/images/left_depth")
    assert (served.status_code, served.content) == (200, parts["left_depth"])
    assert (served.headers["content-type"], served.headers["content-disposition"]) == ("image/png", "attachment")
    archive = zipfile.ZipFile(io.BytesIO(phone.get("/v1/me/export").content))
    assert archive.read(f"photographs/{client_id}/left_depth.png") == parts["left_depth"]
    rows = client.get("/v1/studies/pilot/photographs", headers=admin).json()["items"]
    assert [row["slot"] for row in rows] == ["left", "right", "left_depth"]
    assert rows[2]["path"].endswith("/images/left_depth?participant=P001")
