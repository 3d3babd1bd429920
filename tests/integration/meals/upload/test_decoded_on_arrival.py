"""Photographs are decoded by a child before they are acknowledged: what cannot be is refused while the phone has it."""

import io

import pytest
from PIL import Image

from app.children.api_children import ApiChildren
from app.children.child_pool import ChildPool, ChildResult
from app.core.errors import UnavailableError
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair, photograph, with_hole


def test_jpeg_with_a_hole_is_refused_after_the_meal_too_and_the_whole_one_is_taken_afterwards(phone):
    body, photos = meal_metadata(), pair(progressive=True)
    answer = phone.post(photos | {"right": with_hole(photos["right"])}, metadata=body)
    assert (answer.status_code, answer.json()["code"], answer.json()["slot"]) == (422, "image_unreadable", "right")
    assert phone.get(f"/v1/meals/{body['id']}").status_code == 404
    assert phone.post(photos, metadata=body).status_code == 202
    address = f"/v1/meals/{body['id']}/images/after_left"
    answer = phone.put(address, content=with_hole(photograph(7)))
    assert (answer.status_code, answer.json()["code"]) == (422, "image_unreadable")
    assert phone.put(address, content=photograph(7)).status_code == 202


def test_photograph_that_no_child_has_decoded_is_not_acknowledged_and_is_taken_later(phone, monkeypatch):
    def no_place(*_, **__):
        raise UnavailableError("no child", code="server_busy", retry_after_seconds=3)

    body, photos = meal_metadata(), pair()
    with monkeypatch.context() as patch:
        patch.setattr(ApiChildren, "_admitted", no_place)
        answer = phone.post(photos, metadata=body)
        assert (*refusal(answer), answer.json()["retryable"]) == (503, "server_busy", True)
        assert int(answer.headers["Retry-After"]) > 0
    for outcome, status, code in (("stalled", 503, "server_busy"), ("raised", 500, "internal_error")):
        with monkeypatch.context() as patch:
            patch.setattr(ChildPool, "run", lambda *_, outcome=outcome, **__: ChildResult(outcome))
            assert refusal(phone.post(photos, metadata=body)) == (status, code)
    assert phone.post(photos, metadata=body).status_code == 202


@pytest.mark.parametrize("outcome", ["crashed", "timed_out", "out_of_memory"])
def test_photograph_that_breaks_a_child_is_refused_and_meets_no_second_one(phone, monkeypatch, outcome):
    broken = photograph(3)
    with monkeypatch.context() as patch:
        patch.setattr(ChildPool, "run", lambda *_, **__: ChildResult(outcome))
        answer = phone.post({"left": broken, "right": photograph(4)})
        assert (*refusal(answer), answer.json()["slot"]) == (422, "photograph_not_decoded", "left")
    answer = phone.post({"left": photograph(5), "right": broken})
    assert (*refusal(answer), answer.json()["slot"]) == (422, "photograph_not_decoded", "right")


def test_photograph_sent_again_is_recognised_without_a_child(phone, monkeypatch):
    body, photos = meal_metadata(), pair()
    assert phone.post(photos, metadata=body).status_code == 202
    monkeypatch.setattr(ChildPool, "run", None)
    assert phone.post(photos, metadata=body).status_code == 200
    assert phone.put(f"/v1/meals/{body['id']}/images/left", content=photos["left"]).status_code == 200


def test_costly_photograph_is_known_as_one_where_it_is_taken_and_where_it_is_served(phone, monkeypatch):
    """Its file says so to the child alone; later the stored number does, and the child is not asked."""
    requests = []
    run = ChildPool.run

    def noted(pool, request, *arguments, **options):
        requests.append((request.task, request.is_costly))
        return run(pool, request, *arguments, **options)

    monkeypatch.setattr(ChildPool, "run", noted)
    buffer = io.BytesIO()
    Image.new("RGB", (2000, 1400)).save(buffer, "JPEG", progressive=True)
    body, costly = meal_metadata(), buffer.getvalue()
    scan = costly[costly.rindex(b"\xff\xda") : -2]
    costly = costly[:-2] + scan * (98 - costly.count(b"\xff\xda")) + b"\xff\xd9"
    assert phone.post({"left": costly, "right": photograph(1)}, metadata=body).status_code == 202
    assert requests == [("receive", False), ("receive", True), ("receive", False)]
    requests.clear()
    for slot, is_costly in (("left", True), ("right", False)):
        assert phone.get(f"/v1/meals/{body['id']}/images/{slot}?width=640").status_code == 200
        assert requests.pop() == ("picture", is_costly)
    assert requests == []
