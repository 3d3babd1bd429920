"""Meals of one photograph or of more than two: announced by `views`, complete with the last, estimated from all."""

from app.meals.stored.models import Meal, MealImage
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.meals.upload.measuring import estimate
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
