"""Depth and confidence maps beside a meal's photographs: announced, checked, kept, given to the estimate, given out."""

import io
import json
import pathlib
import struct
import zipfile
import zlib

import numpy as np
import pytest

from app.children.api_children import ApiChildren
from app.children.child_pool import ChildPool, ChildResult
from app.estimates.estimate_meal import EstimateMeal
from app.meals.job_models import Job
from app.meals.models import MealImage
from tests.integration.conftest import meal_metadata
from tests.support.depth_maps import CAMERA, confidence_png, depth_png, depth_tiff, png, table_mm
from tests.support.estimates import answer
from tests.support.photographs import pair, photograph

ALL = ["left_depth", "right_depth", "left_confidence"]


@pytest.fixture
def kind():
    """One kind of database: nothing of this differs between them."""
    return "sqlite"


def with_depth(seed=0, **more):
    return pair(seed) | {"left_depth": depth_png(seed)} | more


def test_meal_with_a_depth_map_in_one_request_is_queued(phone):
    sent = phone.post(with_depth(), depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")
    assert (list(sent.json()["images"]), sent.json()["missing"]) == (["left", "right", "left_depth"], [])
    image = sent.json()["images"]["left_depth"]
    assert (image["media_type"], image["width_px"], image["height_px"], image["durable"]) == ("image/png", 64, 48, True)


def test_meal_waits_for_the_maps_that_it_announced_and_takes_each_again(phone):
    metadata = meal_metadata(depth_camera=CAMERA, depth_maps=ALL)
    client_id = metadata.pop("id")
    assert phone.put(f"/v1/meals/{client_id}", json=metadata).json()["missing"] == ["left", "right", *ALL]
    parts = with_depth(right_depth=depth_tiff(), left_confidence=confidence_png())
    for slot in ("left", "right", "left_depth", "left_confidence"):
        sent = phone.put(f"/v1/meals/{client_id}/images/{slot}", content=parts[slot])
        assert (sent.status_code, sent.json()["status"]) == (202, "receiving")
    assert phone.put(f"/v1/meals/{client_id}/images/left_depth", content=parts["left_depth"]).status_code == 200
    other = phone.put(f"/v1/meals/{client_id}/images/left_depth", content=depth_png(9))
    assert (other.status_code, other.json()["code"]) == (409, "meal_id_reused")
    sent = phone.put(
        f"/v1/meals/{client_id}/images/right_depth",
        content=parts["right_depth"],
        headers={"Content-Type": "image/tiff"},
    )
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")


def test_same_meal_again_is_the_same_and_another_depth_camera_is_not(phone):
    metadata = meal_metadata(depth_camera=CAMERA)
    assert phone.post(with_depth(), metadata).status_code == 202
    assert phone.post(with_depth(), metadata).status_code == 200
    sent = phone.post(with_depth(), metadata | {"depth_camera": CAMERA | {"fx": 60.0}})
    assert (sent.status_code, sent.json()["fields"]) == (409, ["depth_camera"])


def test_announced_map_that_is_not_sent_with_the_photographs_is_400(phone):
    sent = phone.post(pair(), depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["parts"]) == (400, ["left_depth"])


def test_map_that_was_not_announced_is_refused(phone):
    for parts, changes in ((with_depth(), {}), (with_depth(right_depth=depth_png()), {"depth_camera": CAMERA})):
        sent = phone.post(parts, **changes)
        assert (sent.status_code, sent.json()["code"]) == (422, "view_not_announced")


@pytest.mark.parametrize(
    "changes",
    [
        {"depth_maps": ["left_depth"]},
        {"depth_camera": CAMERA | {"fx": 0}},
        {"depth_camera": {"width": 64}},
        {"depth_camera": CAMERA, "depth_maps": ["left_confidence"]},
        {"depth_camera": CAMERA, "depth_maps": ["view3_depth"]},
        {"depth_camera": CAMERA, "depth_maps": ["right_depth"], "views": 1},
    ],
)
def test_impossible_announcement_is_422(phone, changes):
    metadata = meal_metadata(**changes)
    assert phone.put(f"/v1/meals/{metadata.pop('id')}", json=metadata).json()["code"] == "metadata_invalid"


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
    "text": (b"depth", "depth_unreadable"),
    "8 bits": (confidence_png(), "depth_unreadable"),
    "colours": (png(np.zeros((48, 64, 3), np.uint16)), "depth_unreadable"),
    "cut PNG": (depth_png()[:-30], "depth_unreadable"),
    "cut TIFF": (depth_tiff()[:-200], "depth_unreadable"),
    "TIFF of doubles": (tiff_of(table_mm()), "depth_unreadable"),
    "TIFF of whole numbers": (tiff_of(table_mm().astype(np.uint32)), "depth_unreadable"),
    "other size": (depth_png(size=(48, 64)), "depth_mismatch"),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_bad_map_is_refused_by_its_header_and_nothing_is_kept(phone, state, name):
    content, code = BAD_MAPS[name]
    sent = phone.post(pair() | {"left_depth": content}, depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["code"], sent.json()["slot"]) == (422, code, "left_depth")
    with state.database.read() as session:
        assert session.query(MealImage).count() == 0


def test_map_of_too_many_pixels_is_refused_undecoded(phone):
    sent = phone.post(pair() | {"left_depth": png(np.zeros((2500, 4000), np.uint16))}, depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["code"]) == (413, "image_too_many_pixels")


def test_depth_map_as_confidence_map_is_refused(phone):
    parts = with_depth(left_confidence=depth_png())
    sent = phone.post(parts, depth_camera=CAMERA, depth_maps=["left_depth", "left_confidence"])
    assert (sent.status_code, sent.json()["code"], sent.json()["slot"]) == (422, "depth_unreadable", "left_confidence")


def with_other_pixels(content, pixels):
    """The PNG with other bytes for its pixels, and the checksum of these."""
    start = content.index(b"IDAT")
    chunk = b"IDAT" + pixels
    length, checksum = struct.pack(">I", len(pixels)), struct.pack(">I", zlib.crc32(chunk))
    return content[: start - 4] + length + chunk + checksum + content[content.index(b"IEND") - 4 :]


def test_map_that_is_empty_or_cannot_be_decoded_is_refused_by_a_child(phone):
    files = {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in pair().items()}
    assert phone.client.post("/v1/checks", headers=phone.headers, files=files).status_code == 200  # starts a child
    empty = png(np.zeros((48, 64), np.uint16))
    for content, code in ((empty, "depth_empty"), (with_other_pixels(depth_png(), b"nothing"), "depth_unreadable")):
        sent = phone.post(pair() | {"left_depth": content}, depth_camera=CAMERA)
        assert (sent.status_code, sent.json()["code"], sent.json()["slot"]) == (422, code, "left_depth")
    assert phone.post(with_depth(), depth_camera=CAMERA).status_code == 202


@pytest.mark.parametrize("outcome", ["out_of_memory", "crashed", "timed_out"])
def test_map_that_breaks_the_child_that_reads_it_is_refused(phone, monkeypatch, outcome):
    monkeypatch.setattr(ApiChildren, "are_up", True)
    monkeypatch.setattr(ChildPool, "run", lambda *_, **__: ChildResult(outcome))
    sent = phone.post(with_depth(), depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["code"], sent.json()["slot"]) == (422, "depth_unreadable", "left_depth")
    assert "left depth map" in sent.json()["detail"]


@pytest.mark.parametrize("outcome", ["killed", "stalled", "raised"])
def test_map_is_kept_where_the_machine_or_the_program_failed(phone, monkeypatch, outcome):
    monkeypatch.setattr(ApiChildren, "are_up", True)
    monkeypatch.setattr(ChildPool, "run", lambda *_, **__: ChildResult(outcome))
    assert phone.post(with_depth(), depth_camera=CAMERA).status_code == 202


def test_refusals_of_maps_speak_of_maps(phone):
    metadata = meal_metadata(depth_camera=CAMERA, depth_maps=["left_depth", "left_confidence"])
    path = f"/v1/meals/{metadata.pop('id')}"
    phone.put(path, json=metadata)
    missing = phone.get(f"{path}/images/left_depth")
    phone.put(f"{path}/images/left_depth", content=depth_png())
    refusals = [
        (missing, "left depth map"),
        (phone.put(f"{path}/images/left_depth", content=depth_png(9)), "left depth map"),
        (phone.put(f"{path}/images/left_confidence", content=b""), "left confidence map"),
        (phone.put(f"{path}/images/left_confidence", content=confidence_png(size=(48, 64))), "left confidence map"),
        (phone.put(f"{path}/images/left_depth", content=bytes(400_001)), "left depth map"),
    ]
    for refusal, name in refusals:
        assert refusal.status_code >= 400
        assert name in refusal.json()["detail"]
        assert "photograph" not in refusal.json()["detail"]


def test_map_that_is_last_of_all_after_an_after_meal_photograph_completes_the_meal(phone):
    metadata = meal_metadata(depth_camera=CAMERA)
    client_id = metadata.pop("id")
    parts = with_depth()
    phone.put(f"/v1/meals/{client_id}", json=metadata)
    for slot in ("left", "right"):
        phone.put(f"/v1/meals/{client_id}/images/{slot}", content=parts[slot])
    after = phone.put(f"/v1/meals/{client_id}/images/after_left", content=pair(5)["left"])
    assert after.status_code == 202
    sent = phone.put(f"/v1/meals/{client_id}/images/left_depth", content=parts["left_depth"])
    assert (sent.status_code, sent.json()["status"], sent.json()["missing"]) == (202, "queued", [])


@pytest.mark.parametrize("changes", [{"fx": 1500.0}, {"fy": 1e-300}, {"cx": -100000.0}, {"cy": 49.0}])
def test_intrinsics_of_another_picture_are_refused(phone, changes):
    sent = phone.post(with_depth(), depth_camera=CAMERA | changes)
    assert (sent.status_code, sent.json()["code"]) == (422, "depth_camera_invalid")


class RecordingChildren:
    """Answers as a child does, and keeps what it was given."""

    def run(self, request, on_stage, *, seconds=None, name="", is_alone=False):
        self.options = request.arguments["options"]
        self.depths = json.loads(json.dumps(request.arguments["depths"]))
        self.bytes = {
            f"{view} {kind}": pathlib.Path(files[kind]).read_bytes()
            for view, files in self.depths.items()
            for kind in ("depth", "confidence")
            if files[kind] is not None
        }
        return ChildResult("ok", answer())


def test_estimate_is_given_the_maps_and_their_camera(phone, state, settings):
    parts = with_depth(right_depth=depth_tiff(), left_confidence=confidence_png())
    phone.post(parts, depth_camera=CAMERA, depth_maps=ALL)
    children = RecordingChildren()
    with state.database.read() as session:
        job = session.query(Job).one()
    EstimateMeal(state.database, state.blobs, children, settings).compute(job.id)
    assert children.bytes == {
        "left depth": parts["left_depth"],
        "left confidence": parts["left_confidence"],
        "right depth": parts["right_depth"],
    }
    assert children.depths["left"]["camera"] == CAMERA


def test_meal_of_a_study_without_a_marker_needs_a_depth_map_of_the_left_photograph(enrol, state, settings):
    phone = enrol("P001", "bare", marker=None)
    alone = {"left": photograph()}
    refused = phone.post(alone, marker=None, views=1)
    assert (refused.status_code, refused.json()["code"]) == (422, "marker_missing")
    sent = phone.post(alone | {"left_depth": depth_png()}, marker=None, views=1, depth_camera=CAMERA)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")
    children = RecordingChildren()
    with state.database.read() as session:
        job = session.query(Job).one()
    use_case = EstimateMeal(state.database, state.blobs, children, settings)
    result = use_case.load(use_case.compute(job.id))
    with state.database.write() as session:
        use_case.save(session, job.id, result)
    assert children.options["marker"] is None


def test_map_is_given_out_and_exported_as_it_is_stored(phone):
    parts = with_depth()
    client_id = phone.post(parts, depth_camera=CAMERA).json()["id"]
    served = phone.get(f"/v1/meals/{client_id}/images/left_depth")
    assert (served.status_code, served.content) == (200, parts["left_depth"])
    assert (served.headers["content-type"], served.headers["content-disposition"]) == ("image/png", "attachment")
    archive = zipfile.ZipFile(io.BytesIO(phone.get("/v1/me/export").content))
    assert archive.read(f"photographs/{client_id}/left_depth.png") == parts["left_depth"]


def test_manifest_lists_the_map(phone, client, admin):
    phone.post(with_depth(), depth_camera=CAMERA)
    rows = client.get("/v1/studies/pilot/photographs", headers=admin).json()["items"]
    assert [row["slot"] for row in rows] == ["left", "right", "left_depth"]
    assert rows[2]["path"].endswith("/images/left_depth?participant=P001")
