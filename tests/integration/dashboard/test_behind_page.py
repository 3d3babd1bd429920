"""The participants' page as a coordinator uses it: sort, filter, mark several, remind, print, close days, export."""

import html
import re
from datetime import UTC, date, datetime, timedelta

import pytest

from tests.integration.dashboard.conftest import text_of
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, participant_of

PAGE = "/dashboard/studies/pilot/participants"
TODAY = datetime.now(UTC).date()


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"push_contact": "mailto:study@example.org"})


@pytest.fixture
def coordinator(enrol, sign_in_browser, state):
    """P1 has open days 3 and 9 days ago and today, P2 nothing."""
    phone = enrol("P1")
    enrol("P2")
    for ago in (0, 3, 9, 12):
        add_meal(state, "P1", TODAY - timedelta(days=ago), eaten_item())
    close(phone, TODAY - timedelta(days=12))
    close(phone, TODAY - timedelta(days=9))
    answer = phone.put(f"/v1/me/days/{TODAY - timedelta(days=9)}", json={"status": "open"}, headers={"If-Match": "*"})
    assert answer.status_code == 200, "reopened: something is missing"
    return sign_in_browser("coco", pilot="owner")


def codes_of(page):
    return re.findall(r'<th scope="row"><a href="[^"]+">([^<]+)</a>', page)


def test_who_is_behind_comes_first_by_a_link_that_keeps_the_filters(client, admin, coordinator):
    client.patch("/v1/studies/pilot/participants/P1", headers=admin, json={"arm": "A & B", "visit": "v1"})
    page = coordinator.page(PAGE)
    assert codes_of(page) == ["P2", "P1"], "by the last entry"
    assert "A &amp; B" in page
    link = html.unescape(re.search(r'href="([^"]+)">Complete</a>', page)[1])
    page = coordinator.page(link)
    assert codes_of(page) == ["P1", "P2"]
    assert page.count('aria-sort="other"') == 1
    page = coordinator.page(f"{link}&arm=A+%26+B")
    assert codes_of(page) == ["P1"]
    assert "arm=A%20%26%20B" in re.search(r'href="([^"]+)">Phone seen</a>', page)[1]
    assert "arm=A+%26+B" in html.unescape(re.search(r'href="([^"]+)" download', page)[1])


def test_closing_leaves_days_that_have_not_ended_or_that_were_reopened(client, admin, coordinator, state):
    target = f"/dashboard/studies/pilot/closed-days?from={TODAY - timedelta(days=20)}&to={TODAY}"
    answer = coordinator.post(target, participant=["P1", "P2"])
    assert answer.status_code == 303
    assert answer.headers["location"].startswith(f"{PAGE}?from=")
    assert "Open days that were closed: 1." in coordinator.page(PAGE)
    days = client.get("/v1/studies/pilot/participants/P1/days", headers=admin).json()["items"]
    status = {(TODAY - date.fromisoformat(day["date"])).days: day["status"] for day in days}
    assert status == {0: "open", 3: "closed", 9: "open", 12: "closed"}
    assert coordinator.post(target, participant=["P1"]).status_code == 303
    assert "Open days that were closed: 0." in coordinator.page(PAGE)
    assert coordinator.post(target).status_code == 422, "nobody is marked"


def test_marked_participants_are_reminded_or_named_and_cards_and_file_are_of_them(coordinator, client, admin):
    page = coordinator.page(PAGE, arm="")
    for label in ("Remind", "Close days", "Print cards", "Export"):
        assert f">{label}</button>" in page
    assert (
        coordinator.post("/dashboard/studies/pilot/reminders?order=seen", participant=["P1", "P2"]).status_code == 303
    )
    told = text_of(coordinator.page(PAGE))
    assert "0 of 2 participants are reminded. No phone of the others wants reminders" in told
    assert ">P1 P2</textarea>" in coordinator.page("/dashboard/studies/pilot/enrol", participant=["P1", "P2"])
    file = coordinator.get("/dashboard/studies/pilot/files/progress", format="csv", participant=["P2"]).text
    assert [line.split(",")[0] for line in file.splitlines()] == ["code", "P2"]


def test_viewer_marks_nobody_and_who_left_or_is_excluded_cannot_be_marked(enrol, sign_in_browser, state, coordinator):
    viewer = sign_in_browser("vera", pilot="viewer")
    page = viewer.page(PAGE)
    assert "checkbox" not in page
    assert "Remind" not in page
    assert viewer.post("/dashboard/studies/pilot/reminders", participant="P1").status_code == 403
    with state.database.write() as session:
        participant_of(session, "P1").excluded = "moved <b>away</b>"
    page = coordinator.page(PAGE)
    assert 'title="moved &lt;b&gt;away' in page
    assert re.findall(r'name="participant" value="([^"]+)"', page) == ["P2"]
