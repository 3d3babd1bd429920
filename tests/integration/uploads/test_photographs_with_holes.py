"""A JPEG that lost bytes in its middle is refused before it is acknowledged: then the phone still has the whole one."""

import pytest

from app.children.api_children import ApiChildren
from app.children.child_pool import ChildResult
from app.children.fair_line import LineFullError
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair, photograph, with_hole


@pytest.fixture
def phone(phone):
    """A phone of a server whose children are up."""
    files = {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in pair().items()}
    assert phone.client.post("/v1/checks", headers=phone.headers, files=files).status_code == 200
    return phone


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


def test_meal_is_kept_where_children_are_busy_or_make_a_mistake_or_are_not_up(phone, monkeypatch):
    def no_place(*_, **__):
        raise LineFullError

    def mistake(*_, **__):
        return ChildResult("raised", message="KeyError: 'photo'")

    for name, value in (
        ("fair_line.FairLine.place", no_place),
        ("child_pool.ChildPool.run", mistake),
        ("api_children.ApiChildren.run", None),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(f"app.children.{name}", value)
            patch.setattr(ApiChildren, "are_up", value is not None)
            assert phone.post(pair()).status_code == 202, name
