"""Meals of one photograph or of more than two: announced by `views`, complete with the last, estimated from all."""

import json
import pathlib

import cv2
import pytest

from app.children.child_pool import ChildResult
from app.estimates.estimate_meal import EstimateMeal
from app.estimates.run_estimate import estimate_task
from app.meals.job_models import Job
from app.meals.models import Meal, MealImage
from tests.integration.conftest import meal_metadata
from tests.support.estimates import answer
from tests.support.photographs import pair, photograph

JPEG = {"Content-Type": "image/jpeg"}


def three(seed=0):
    return pair(seed) | {"view3": photograph(100 + seed)}


class RecordingChildren:
    """Answers as a child does, and keeps the bytes of the photographs by view, in their order."""

    def run(self, request, on_stage, *, seconds=None, name="", is_alone=False):
        self.photographs = {
            view: pathlib.Path(path).read_bytes() for view, path in request.arguments["photographs"].items()
        }
        return ChildResult("ok", answer())


def test_meal_of_three_photographs_in_one_request_is_queued(phone):
    sent = phone.post(three(), views=3)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")
    assert (list(sent.json()["images"]), sent.json()["missing"]) == (["left", "right", "view3"], [])
    assert sent.json() == phone.get(f"/v1/meals/{sent.json()['id']}").json()


def test_meal_of_one_photograph_is_queued(phone):
    sent = phone.post({"left": photograph()}, views=1)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")
    assert (list(sent.json()["images"]), sent.json()["missing"]) == (["left"], [])


def test_right_photograph_of_a_meal_announced_with_one_is_refused(phone):
    sent = phone.post(pair(), views=1)
    assert (sent.status_code, sent.json()["code"], sent.json()["slots"]) == (422, "view_not_announced", ["right"])


def test_one_photograph_that_was_not_announced_as_such_waits_for_its_pair(phone):
    sent = phone.post({"left": photograph()})
    assert (sent.status_code, sent.json()["code"], sent.json()["parts"]) == (400, "part_missing", ["right"])


def test_estimate_reads_every_view_in_order(phone, state, settings):
    photos = three()
    phone.post(photos, views=3)
    children = RecordingChildren()
    with state.database.read() as session:
        job = session.query(Job).one()
    EstimateMeal(state.database, state.blobs, children, settings).compute(job.id)
    assert list(children.photographs.items()) == list(photos.items())


def test_announced_meal_waits_for_its_last_view(phone):
    metadata, photos = meal_metadata(views=4), three() | {"view4": photograph(104)}
    client_id = metadata.pop("id")
    assert phone.put(f"/v1/meals/{client_id}", json=metadata).json()["missing"] == ["left", "right", "view3", "view4"]
    for slot in ("view4", "left", "right"):
        sent = phone.put(f"/v1/meals/{client_id}/images/{slot}", content=photos[slot], headers=JPEG)
        assert (sent.status_code, sent.json()["status"]) == (202, "receiving")
    sent = phone.put(f"/v1/meals/{client_id}/images/view3", content=photos["view3"], headers=JPEG)
    assert (sent.status_code, sent.json()["status"]) == (202, "queued")


def test_announced_view_that_is_not_sent_with_the_others_is_400(phone):
    sent = phone.post(pair(), views=3)
    assert (sent.status_code, sent.json()["code"], sent.json()["parts"]) == (400, "part_missing", ["view3"])


def test_view_beyond_those_announced_is_refused_and_nothing_is_kept(phone, state):
    sent = phone.post(three())
    assert (sent.status_code, sent.json()["code"], sent.json()["slots"]) == (422, "view_not_announced", ["view3"])
    with state.database.read() as session:
        assert (session.query(Meal).count(), session.query(MealImage).count()) == (0, 0)


def test_view_beyond_those_announced_is_refused_part_by_part(phone):
    metadata = meal_metadata(views=3)
    client_id = metadata.pop("id")
    phone.put(f"/v1/meals/{client_id}", json=metadata)
    sent = phone.put(f"/v1/meals/{client_id}/images/view4", content=photograph(), headers=JPEG)
    assert (sent.status_code, sent.json()["code"]) == (422, "view_not_announced")


def test_same_id_with_another_number_of_views_is_another_meal(phone):
    metadata = meal_metadata()
    phone.post(pair(), metadata)
    sent = phone.post(three(), metadata | {"views": 3})
    assert (sent.status_code, sent.json()["code"], sent.json()["fields"]) == (409, "meal_id_reused", ["views"])
    assert phone.post(pair(), metadata | {"views": 2}).status_code == 200  # 2 is what is meant without it


@pytest.mark.parametrize("views", [0, 9, 2.5, "3", True])
def test_number_of_views_out_of_range_or_no_number_is_422(phone, views):
    assert phone.post(pair(), views=views).status_code == 422


def test_further_view_is_served_as_taken(phone):
    client_id = phone.post(three(), views=3).json()["id"]
    served = phone.get(f"/v1/meals/{client_id}/images/view3", width=320)
    assert (served.status_code, served.headers["x-colour-correction"]) == (200, "none")


class ChildrenInProcess:
    """Runs the pipeline here."""

    def run(self, request, on_stage, *, seconds=None, name="", is_alone=False):
        return ChildResult("ok", estimate_task(json.loads(json.dumps(request.arguments)), on_stage))


@pytest.mark.slow
@pytest.mark.parametrize(("views", "tolerance"), [(1, 1.0), (3, 0.2)])
def test_rendered_meal_is_measured_by_all_of_its_photographs(phone, state, settings, shared_data, views, tolerance):
    folder = shared_data / "scenes" / "dev" / "views" / "views-01"
    truth = json.loads((folder / "truth.json").read_text())
    whole = truth["camera"]
    camera = {"fx": whole["f"] / 2, "fy": whole["f"] / 2, "distortion": whole["distortion"]}
    camera |= {"width": 1024, "height": 768, "cx": whole["cx"] / 2, "cy": whole["cy"] / 2}
    slots = list(three())[:views]
    photos = {slot: half_size(folder / f"v{number}.jpg") for number, slot in enumerate(slots, start=1)}
    client_id = phone.post(photos, views=views, camera=camera).json()["id"]
    with state.database.read() as session:
        job = session.query(Job).one()
    use_case = EstimateMeal(state.database, state.blobs, ChildrenInProcess(), settings)
    result = use_case.load(use_case.compute(job.id))
    assert result.answer.failure is None
    with state.database.write() as session:
        use_case.save(session, job.id, result)
    meal = phone.get(f"/v1/meals/{client_id}").json()
    assert meal["run"]["parameters"]["views"] == views
    (item,) = meal["items"]
    assert item["volume_ml"] == pytest.approx(truth["items"][0]["volume_ml"], rel=tolerance)
    assert ("single_view" in item["flags"]) == (views == 1)


def half_size(path):
    picture = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_2)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
