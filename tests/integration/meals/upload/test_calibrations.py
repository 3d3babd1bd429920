"""/v1/calibrations: a phone's camera measured, kept with its error, used for its meals, withdrawn; bad ones refused."""

import json
import uuid
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
import pytest

from app.children.api_children import ApiChildren
from app.meals.estimate.camera_choice import choose_camera
from app.people.models import CameraCalibration, Device, Participant, Study
from app.vision.marker_spec import parse_marker
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.meals.upload.measuring import estimate
from tests.support.photographs import pair
from tests.unit.vision.synthetic import PHONE, look_at, render_board

CAMERA = replace(
    PHONE, width=800, height=600, fx=640.0, fy=640.0, cx=393.0, cy=303.0, distortion=(0.06, -0.1, 0.0, 0.0, 0.0)
)
SLANTS = [(60, -90, 0), (50, 0, 20), (55, 120, -30), (80, -90, 90), (45, 60, 10), (50, -150, 45)]
AIMS = [(0, 0), (40, 25), (-45, -30), (35, -35), (-45, 35), (0, 0)]


def jpeg(pixels):
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


@pytest.fixture(scope="module")
def boards():
    board = parse_marker("plain:9x7:11")
    return [
        render_board(board, CAMERA, look_at(*slant[:2], 200.0, slant[2], target_mm=(*aim, 0))).pixels_bgr
        for slant, aim in zip(SLANTS, AIMS, strict=True)
    ]


def calibrate(phone, photos, **metadata):
    files = [("photo", (f"{number}.jpg", content, "image/jpeg")) for number, content in enumerate(photos)]
    if metadata:
        files.append(("metadata", ("m.json", json.dumps(metadata), "application/json")))
    return phone.client.post("/v1/calibrations", headers=phone.headers, files=files)


def kept_camera(focal=960.0, width=1200, height=900, cx=600.0, k1=0.0):
    numbers = {"fx": focal, "fy": focal, "cx": cx, "cy": 450.0 * height / 900}
    return {"width": width, "height": height, "distortion": [k1, 0, 0, 0, 0]} | numbers


def keep(state, device, *, model=None, age=0, withdrawn=False, **camera):
    now = datetime.now(UTC)
    measured = {"marker": "plain:9x7:11", "camera": kept_camera(**camera), "rms_px": 0.2, "photographs": 10}
    times = {"created_at": now - timedelta(hours=age), "withdrawn_at": now if withdrawn else None}
    row = CameraCalibration(id=uuid.uuid4(), device_id=device.id, model=model, author="test", **measured, **times)
    with state.database.write() as session:
        session.add(row)
    return row.id


def devices(state):
    with state.database.read() as session:
        return session.query(Device).order_by(Device.enrolled_at, Device.id).all()


def set_model(state, model):
    with state.database.write() as session:
        session.query(Device).update({"model": model})


def chosen(state, device, sizes=((1200, 900), (1200, 900)), given=None):
    with state.database.read() as session:
        study = session.query(Study).filter(Study.code == "pilot").one()
        return choose_camera(session, meal_camera=given, device_id=device.id, study=study, sizes=list(sizes))


def test_known_camera_is_measured_without_bad_photographs_listed_and_withdrawn(phone, client, admin, boards):
    bare = np.full((600, 800, 3), 120, np.uint8)
    made = calibrate(phone, [jpeg(bare), *(jpeg(board) for board in boards)])
    assert made.status_code == 201, made.text
    body = made.json()
    assert (body["camera"]["width"], body["camera"]["height"]) == (800, 600)
    # six views with 0.05 px of noise: half a percent of focal length (tests/unit/vision/test_calibration.py)
    assert body["camera"]["fx"] == pytest.approx(640.0, rel=5e-3)
    assert body["rms_px"] < 0.3
    assert body["photographs"] == 6
    assert [(one["photograph"], one["code"]) for one in body["left_out"]] == [(1, "image_blurred")]
    (listed,) = phone.get("/v1/calibrations").json()["items"]
    assert listed == {name: value for name, value in body.items() if name != "left_out"}
    (of_study,) = client.get("/v1/studies/pilot/calibrations", headers=admin).json()["items"]
    assert (of_study["id"], of_study["participant"]) == (body["id"], "P001")
    for _ in range(2):
        withdrawn = phone.client.post(f"/v1/calibrations/{body['id']}/withdrawal", headers=phone.headers)
        assert withdrawn.status_code == 200
        assert withdrawn.json()["withdrawn_at"] is not None


@pytest.mark.slow
def test_bad_photographs_are_refused_with_their_reason(phone, boards):
    good = [jpeg(board) for board in boards]
    turned = jpeg(np.ascontiguousarray(np.rot90(boards[0])))
    vast = jpeg(np.zeros((4000, 4000, 3), np.uint8))
    assert refusal(calibrate(phone, [b"x"] * 31)) == (400, "part_repeated")
    assert refusal(calibrate(phone, good, marker="plain:9x7:0")) == (422, "marker_invalid")
    for photos, code in (
        (good[:2], "calibration_count"),
        ([good[0]] * 3, "calibration_views_insufficient"),
        ([*good, turned], "calibration_size_differs"),
        ([*good, b"no picture"], "not_an_image"),
        ([*good, vast], "image_too_many_pixels"),
        ([*good[:3], good[3][:9000]], "image_truncated"),
    ):
        assert refusal(calibrate(phone, photos)) == (422, code)
    assert phone.get("/v1/calibrations").json()["items"] == []


@pytest.mark.slow
def test_board_seen_in_the_middle_only_is_refused(phone, boards):
    far = [cv2.resize(board, None, fx=0.55, fy=0.55, interpolation=cv2.INTER_AREA) for board in boards]
    framed = [cv2.copyMakeBorder(board, 135, 135, 180, 180, cv2.BORDER_REPLICATE) for board in far]
    assert refusal(calibrate(phone, [jpeg(one) for one in framed])) == (422, "calibration_coverage_small")


def test_owner_withdraws_a_calibration_and_for_another_phone_there_is_none(phone, enrol, client, admin, state):
    other = enrol("P002")
    device = devices(state)[0]
    path = f"/v1/calibrations/{keep(state, device)}/withdrawal"
    assert client.post(path, headers=other.headers).status_code == 404
    assert client.post(f"/v1/calibrations/{uuid.uuid4()}/withdrawal", headers=phone.headers).status_code == 404
    assert other.get("/v1/calibrations").json()["items"] == []
    assert client.post(path, headers=admin).json()["withdrawn_at"] is not None
    assert chosen(state, device).chosen_from == "exif"


def test_newest_calibration_of_the_phone_that_fits_holds_until_it_is_withdrawn_but_the_meals_own_always(phone, state):
    (device,) = devices(state)
    older = keep(state, device, age=2, focal=950.0)
    keep(state, device, age=1, focal=990.0, withdrawn=True)
    found = chosen(state, device)
    assert (found.chosen_from, found.calibrations, found.camera.fx) == ("device", (older,), 950.0)
    with state.database.write() as session:
        session.query(Study).one().camera = kept_camera(width=1000, height=1000)
    assert chosen(state, device, [(1000, 1000)] * 2).chosen_from == "study"
    assert chosen(state, device, [(1200, 900), (1000, 1000)]).chosen_from == "exif"
    assert chosen(state, device, [(900, 1200)] * 2).chosen_from == "device"  # turned by a quarter
    own = chosen(state, device, [(1000, 1000)] * 2, given=kept_camera(focal=1234.0))
    assert (own.chosen_from, own.camera.fx) == ("meal", 1234.0)


def test_phone_without_calibration_gets_the_median_of_its_model_at_its_size(phone, enrol, state):
    for number in range(2, 5):
        enrol(f"P00{number}")
    set_model(state, "Phone 7")
    first, *others = devices(state)
    keep(state, others[0], model="Phone 7", focal=900.0, k1=0.1)
    keep(state, others[0], model="Phone 7", focal=1500.0, age=5)  # not that phone's newest
    keep(state, others[1], model="Phone 7", focal=1880.0, k1=0.3, width=2400, height=1800, cx=1200.5)
    keep(state, others[2], model="Phone 7", focal=1000.0, k1=0.2, cx=610.0)
    found = chosen(state, first)
    assert found.chosen_from == "model"
    assert len(found.calibrations) == 3
    assert found.camera.fx == 940.0  # 1880 px at twice the size
    assert found.camera.cx == 600.0
    assert found.camera.distortion[0] == 0.2


def test_single_phone_of_the_model_stands_for_it_and_other_models_and_studies_do_not(phone, enrol, state):
    enrol("P002")
    set_model(state, "Phone 7")
    first, second = devices(state)
    number = keep(state, second, model="Phone 7", focal=930.0)
    enrol("P001", study="another")
    set_model(state, "Phone 7")
    keep(state, devices(state)[2], model="Phone 7", focal=500.0)
    assert chosen(state, first).calibrations == (number,)
    with state.database.write() as session:
        session.get(Device, first.id).model = "Phone 8"
    assert chosen(state, first).chosen_from == "exif"


def test_meal_is_measured_with_its_phones_calibration_and_its_run_says_so(phone, state, settings):
    (device,) = devices(state)
    number = keep(state, device, width=640, height=480, cx=320.0, focal=512.0)
    body = meal_metadata()
    phone.post(pair(), metadata=body)
    assert estimate(state, settings, body["id"]).options["camera"]["fx"] == 512.0
    run = phone.get(f"/v1/meals/{body['id']}").json()["run"]
    assert run["parameters"]["camera_from"] == "device"
    assert run["camera"]["left"]["chosen_from"] == "device"
    assert run["camera"]["left"]["calibrations"] == [str(number)]


@pytest.mark.both_stores
@pytest.mark.slow
def test_calibration_of_who_leaves_meanwhile_is_not_kept_and_no_row_holds_the_alias(phone, state, boards, monkeypatch):
    photos = [jpeg(board) for board in boards]
    assert calibrate(phone, photos).status_code == 201
    with state.database.read() as session:
        alias = str(session.query(Participant).one().alias)
        (row,) = session.query(CameraCalibration).all()
    assert alias not in row.author
    run = state.part(ApiChildren).run

    def leaves(*arguments, **named):
        found = run(*arguments, **named)
        with state.database.write() as session:
            session.query(Participant).update({"withdrawn_at": datetime.now(UTC)})
        return found

    monkeypatch.setattr(
        type(state.part(ApiChildren)), "run", lambda _, *arguments, **named: leaves(*arguments, **named)
    )
    assert refusal(calibrate(phone, photos)) == (410, "withdrawn")
