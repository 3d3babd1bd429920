"""Unknown addresses, and refused pages with a link back."""

import pytest

from tests.integration.dashboard.conftest import text_of

PILOT = "/dashboard/studies/pilot"
BACK = f'<a href="{PILOT}">Back to '


@pytest.fixture
def viewer(enrol, sign_in_browser):
    enrol()
    return sign_in_browser("vera", pilot="viewer")


@pytest.mark.parametrize("path", ["mealz", "meals/P001", "releases/one/files/two/three"])
def test_unknown_address_in_a_study_is_404_with_a_link_back(viewer, path):
    answer = viewer.get(f"{PILOT}/{path}")
    assert answer.status_code == 404
    assert "There is no such page." in text_of(answer.text)
    assert BACK in answer.text


def test_refused_page_of_a_study_has_a_link_back(viewer):
    for path, asked in ((f"{PILOT}/participants/X9", {}), (f"{PILOT}/meals", {"from": "yesterday"})):
        answer = viewer.get(path, **asked)
        assert answer.status_code in (404, 422)
        assert BACK in answer.text


def test_trailing_slash_is_redirected(viewer):
    for path, led_to in ((f"{PILOT}/", PILOT), (f"{PILOT}/meals/", f"{PILOT}/meals")):
        answer = viewer.get(path, view="table")
        assert (answer.status_code, answer.headers["location"]) == (307, f"{led_to}?view=table")


def test_unknown_address_does_not_reveal_a_study_to_a_stranger(viewer, sign_in_browser):
    stranger = sign_in_browser("sam")
    for study in ("pilot", "none-such"):
        answer = stranger.get(f"/dashboard/studies/{study}/mealz")
        assert answer.status_code == 404
        assert "There is no such study." in text_of(answer.text)
        assert "Back to" not in answer.text


def test_unknown_address_outside_of_studies_is_404(viewer, client):
    answer = viewer.get("/dashboard/nowhere")
    assert answer.status_code == 404
    assert "There is no such page." in text_of(answer.text)
    assert "Back to" not in answer.text
    assert client.get("/v1/nowhere").json()["detail"] == "Not Found", "the API's problem documents are as they were"
