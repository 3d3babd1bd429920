"""The page of a study's flow has the API's numbers, in its list and by arm."""

from tests.integration.dashboard.conftest import text_of
from tests.integration.diary.test_flow import PATH, make_study

PAGE = "/dashboard/studies/pilot/flow"


def test_flow_page_has_the_apis_numbers_and_its_file(client, admin, enrol, state, sign_in_browser):
    make_study(client, admin, enrol, state)
    viewer = sign_in_browser("vera", pilot="viewer")
    page = viewer.page(PAGE, least_days="2")
    text = text_of(page)
    for told in (
        "Registered: 6",
        "Not enrolled: 1",
        "Withdrawn: 2",
        "Excluded: 1",
        "complete days: 1",
        "Analysed: 1",
    ):
        assert told in text
    assert "Enrolled: 5" in text
    assert "&lt;b&gt;diabetes&lt;/b&gt;: " in page
    assert "no consent: 1" in text
    assert "Registered 3 2 1 6" in text, "A, B, no arm (erased), all"
    file = viewer.get("/dashboard/studies/pilot/files/flow", format="csv", least_days="2")
    assert file.content == client.get(PATH, headers=admin, params={"format": "csv", "least_days": 2}).content
