"""Unknown addresses, and refused pages with a link back."""

from tests.integration.dashboard.conftest import text_of

PILOT = "/dashboard/studies/pilot"


def test_refused_or_unknown_page_of_a_study_has_a_link_back(viewer, client):
    for path in ("mealz", "meals/P001", "releases/one/files/two/three", "participants/X9", "meals?from=yesterday"):
        answer = viewer.get(f"{PILOT}/{path}")
        assert answer.status_code == (422 if "?" in path else 404)
        is_page = path.startswith(("participants", "meals?"))
        assert ("There is no such page." in text_of(answer.text)) is not is_page
        assert f'<a href="{PILOT}">Back to ' in answer.text
    answer = viewer.get("/dashboard/nowhere")
    assert answer.status_code == 404
    assert "There is no such page." in text_of(answer.text)
    assert "Back to" not in answer.text
    assert client.get("/v1/nowhere").json()["detail"] == "Not Found", "the API's problem documents are as they were"


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
