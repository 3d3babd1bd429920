"""The worker's part in an after-meal pair: its own photographs, hints and camera; and the whole way on real pixels."""

import io
import json
import pathlib

import pytest
from PIL import Image

from app.core.errors import Failure
from app.jobs import queries as jobs
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.estimate.run_estimate import estimate_task
from app.meals.stored.job_models import Job
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.measuring import estimate
from tests.integration.records.after_pairs import Table, left_of_apple
from tests.support.photographs import photograph

RENDERED = pathlib.Path(__file__).parents[2] / "data" / "after_meal"
DEMO = pathlib.Path(__file__).parents[3] / "app" / "demo_data"
CAMERA = {"width": 640, "height": 480, "fx": 512.0, "fy": 512.0, "cx": 320.0, "cy": 240.0}


def test_after_run_has_the_pairs_own_photographs_hints_and_camera(phone, state, settings):
    table = Table(phone, state).measured()
    table.tell(hints=[{"point": [5, 6], "class": "refuse"}], camera=CAMERA)
    table.send_after()
    children = estimate(state, settings, table.id, left_of_apple(hint=0), purpose="after")
    assert children.photographs == {"left": photograph(71), "right": photograph(72)}
    assert children.options["hints"] == [{"point": [5.0, 6.0]}]
    assert children.options["camera"]["fx"] == 512.0
    (left,) = table.after["leftovers"]
    assert (left["class"], left["flags"]) == ("refuse", [])
    assert table.get()["stage"] is None
    assert "/runs/" in children.key


def test_after_run_falls_back_on_the_meals_camera(phone, state, settings):
    table = Table(phone, state, camera=CAMERA).measured().send_after()
    options = estimate(state, settings, table.id, purpose="after").options
    assert (options["camera"]["fx"], options["hints"]) == (512.0, [])


def test_worker_that_begins_or_fails_an_after_job_moves_the_pair_only(phone, state):
    table = Table(phone, state).measured().send_after()
    before = table.get()["status"]
    with state.database.write() as session:
        job = session.query(Job).filter(Job.purpose == "after").one()
        job.executor_id = "worker"
        assert jobs.start_attempt(session, job.id, "worker", job.enqueued_at) is job
    assert (table.get()["status"], table.after["status"]) == (before, "processing")
    with state.database.write() as session:
        found = jobs.lock_live_job(session, job.id)
        jobs.fail_job(*found, Failure("estimate_timed_out", "It took too long.", "Try again."), job.enqueued_at)
        EstimatePair(state.database, state.blobs, None, None).settle(session, found[1])
    meal = table.get()
    assert (meal["status"], meal["failure"]) == (before, None)
    assert (meal["after"]["status"], meal["after"]["failure"]["code"]) == ("failed", "estimate_timed_out")
    assert all("after_failed" in item["flags"] for item in meal["items"])


def again(slot):
    """The same photograph in other bytes, its EXIF kept."""
    with Image.open(DEMO / f"{slot}.jpg") as image:
        buffer = io.BytesIO()
        image.save(buffer, "JPEG", quality=88, exif=image.getexif())
    return buffer.getvalue()


@pytest.mark.slow
def test_half_an_orange_is_found_again_though_marker_and_phone_stand_elsewhere(phone, state, settings):
    """A rendered meal of known volumes, the after-meal pair without a hint: who was eaten, and how much."""
    truth = json.loads((RENDERED / "truth.json").read_text())
    photos = {slot: (RENDERED / f"before_{slot}.jpg").read_bytes() for slot in ("left", "right")}
    hints = [{"point": item["point"], "food": item["food"]} for item in truth["before"]["items"]]
    metadata = meal_metadata(hints=hints)
    assert phone.post(photos, metadata).status_code == 202
    path = f"/v1/meals/{metadata['id']}"
    for slot in ("left", "right"):
        content = (RENDERED / f"after_{slot}.jpg").read_bytes()
        assert phone.put(f"{path}/images/after_{slot}", content=content).status_code == 202
    for purpose in ("meal", "after"):
        estimate(state, settings, metadata["id"], purpose=purpose, run=estimate_task)
    meal = phone.get(path).json()
    orange, kiwi = (next(i for i in meal["items"] if i["food"]["key"] == hint["food"]) for hint in hints)
    (left,) = meal["after"]["leftovers"]
    assert (left["item"], left["class"], left["is_by_person"]) == (orange["id"], "food_left", False)
    (served_ml, kiwi_ml), (left_ml,) = ([i["volume_ml"] for i in truth[pair]["items"]] for pair in ("before", "after"))
    edible_g_per_ml = orange["density_g_per_ml"] * orange["edible_share"]
    eaten_g = (served_ml - left_ml) * edible_g_per_ml
    assert orange["consumed_g"] == pytest.approx(eaten_g, rel=0.15)  # two volumes, each within 5 % here
    assert orange["consumed_interval_g"][0] < eaten_g < orange["consumed_interval_g"][1]
    assert (kiwi["left_g"], kiwi["consumed_g"]) == (0.0, kiwi["edible_g"])
    assert kiwi["volume_ml"] == pytest.approx(kiwi_ml, rel=0.15)
