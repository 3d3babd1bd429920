"""Unknown addresses, and refused pages with a link back."""

from tests.integration.dashboard.conftest import text_of

PILOT = "/dashboard/studies/pilot"


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
