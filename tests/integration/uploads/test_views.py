"""Meals of one photograph or of more than two: announced by `views`, complete with the last, estimated from all."""

import json

import cv2
import pytest

from app.estimates.run_estimate import estimate_task
from app.meals.models import Meal, MealImage
from tests.integration.conftest import meal_metadata
from tests.integration.uploads.answers import refusal
from tests.integration.uploads.measuring import estimate
from tests.support.photographs import pair, photograph


def three(seed=0):
    return pair(seed) | {"view3": photograph(100 + seed)}


def test_meal_of_one_or_three_photographs_is_queued_and_a_further_view_is_served(phone):
    for photos in ({"left": photograph()}, three()):
        sent = phone.post(photos, views=len(photos))
        assert (sent.status_code, sent.json()["status"]) == (202, "queued")
        assert (list(sent.json()["images"]), sent.json()["missing"]) == (list(photos), [])
    path = f"/v1/meals/{sent.json()['id']}"
    assert sent.json() == phone.get(path).json()
    served = phone.get(f"{path}/images/view3", width=320)
    assert (served.status_code, served.headers["x-colour-correction"]) == (200, "none")


def test_estimate_reads_every_view_in_order(phone, state, settings):
    photos = three()
    children = estimate(state, settings, phone.post(photos, views=3).json()["id"])
    assert list(children.photographs.items()) == list(photos.items())


def test_announced_meal_waits_for_its_last_view(phone):
    metadata, photos = meal_metadata(views=4), three() | {"view4": photograph(104)}
    path = f"/v1/meals/{metadata.pop('id')}"
    assert phone.put(path, json=metadata).json()["missing"] == ["left", "right", "view3", "view4"]
    assert refusal(phone.put(f"{path}/images/view5", content=photograph())) == (422, "view_not_announced")
    for slot in ("view4", "left", "right", "view3"):
        sent = phone.put(f"{path}/images/{slot}", content=photos[slot])
        assert (sent.status_code, sent.json()["status"]) == (202, "queued" if slot == "view3" else "receiving")


def test_view_too_few_or_too_many_is_refused_and_nothing_is_kept(phone, state):
    for photos, views, views_missing in (({"left": photograph()}, None, ["right"]), (pair(), 3, ["view3"])):
        sent = phone.post(photos, views=views)
        assert (*refusal(sent), sent.json()["parts"]) == (400, "part_missing", views_missing)
    for photos, views, unannounced in ((pair(), 1, ["right"]), (three(), None, ["view3"])):
        sent = phone.post(photos, views=views)
        assert (*refusal(sent), sent.json()["slots"]) == (422, "view_not_announced", unannounced)
    for views in (0, 9, 2.5, "3", True):
        assert phone.post(pair(), views=views).status_code == 422
    with state.database.read() as session:
        assert (session.query(Meal).count(), session.query(MealImage).count()) == (0, 0)


def test_same_id_with_another_number_of_views_is_another_meal(phone):
    metadata = meal_metadata()
    phone.post(pair(), metadata)
    sent = phone.post(three(), metadata | {"views": 3})
    assert (sent.status_code, sent.json()["code"], sent.json()["fields"]) == (409, "meal_id_reused", ["views"])
    assert phone.post(pair(), metadata | {"views": 2}).status_code == 200  # 2 is what is meant without it


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
    estimate(state, settings, client_id, run=estimate_task)
    meal = phone.get(f"/v1/meals/{client_id}").json()
    assert meal["failure"] is None
    assert meal["run"]["parameters"]["views"] == views
    (item,) = meal["items"]
    assert item["volume_ml"] == pytest.approx(truth["items"][0]["volume_ml"], rel=tolerance)
    assert ("single_view" in item["flags"]) == (views == 1)


def half_size(path):
    picture = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_2)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
