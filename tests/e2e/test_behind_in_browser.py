"""A coordinator finds who is behind and reminds them in four clicks; the pages are legible, wide and narrow."""

import re
from datetime import UTC, datetime, timedelta

import pytest

from app.extras.reminders.web_push import text_of
from tests.e2e.browser import require_legible
from tests.e2e.dashboard_server import PASSWORD, require
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.support.push_services import Browser

pytestmark = pytest.mark.slow

STUDY = "/dashboard/studies/behind"
SILENT = (2, 4, 5)
TODAY = datetime.now(UTC).date()


@pytest.fixture(scope="module")
def behind(served):
    """P001 and P003 have meals, P003 is excluded; P002, P004 and P005 have none and want reminders."""
    served.make_study("behind", "Who is behind")
    served.make_staff("coco", behind="owner")
    people = "/v1/studies/behind/participants"
    for number, arm in ((1, "low salt"), (2, "low salt"), (3, "control"), (4, "control"), (5, "control")):
        code = f"P00{number}"
        with served.enrol(code, "behind") as phone:
            require(served.admin.patch(f"{people}/{code}", json={"arm": arm, "visit": "week 4"}))
            if number in SILENT:
                require(phone.put("/v1/me/reminders", json=wanted(Browser(), number)))
        if number not in SILENT:
            for ago in range(2, 8):
                add_meal(served, code, TODAY - timedelta(days=ago), eaten_item(), study="behind")
    require(served.admin.patch(f"{people}/P003", json={"excluded": "moved away"}))
    return served


def wanted(browser, number):
    keys = {"p256dh": text_of(browser.receiver.public_key), "auth": text_of(browser.receiver.auth)}
    quiet = {"quiet_from": "22:00", "quiet_until": "22:00", "time_zone": "UTC", "times": None}
    return {"subscription": {"endpoint": f"https://push.example.org/send/{number}", "keys": keys}} | quiet


def test_coordinator_finds_who_is_behind_and_reminds_three_in_four_clicks(behind, open_page):
    watched = open_page(behind.address)
    watched.sign_in("coco", PASSWORD, STUDY)
    page = watched.page
    page.get_by_role("link", name="Participants", exact=True).click()
    page.get_by_label("Mark P002").click()
    page.get_by_label("Mark P005").click(modifiers=["Shift"])
    page.get_by_role("button", name="Remind").click()
    page.wait_for_selector("text=3 of 3 participants are reminded.")
    page.get_by_role("link", name="Complete").click()
    page.wait_for_url(re.compile("order=complete"))
    require_legible(page, "behind")


def test_all_are_marked_at_once_and_closing_asks_first(behind, open_page):
    watched = open_page(behind.address)
    watched.sign_in("coco", PASSWORD, f"{STUDY}/participants")
    page = watched.page
    page.get_by_label("Mark all").check()
    assert page.locator("td input:checked").count() == 4, "who is excluded cannot be marked"
    questions = []
    page.once("dialog", lambda dialog: (questions.append(dialog.message), dialog.dismiss()))
    page.get_by_role("button", name="Close days").click()
    assert "Days without an entry stay open" in questions[0]
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Close days").click()
    page.wait_for_selector("text=Open days that were closed: 6.")
    page.get_by_label("Mark all").check()
    page.get_by_role("button", name="Print cards").click()
    page.wait_for_url(re.compile("enrol"))
    assert page.input_value("#participants").split() == ["P002", "P004", "P005", "P001"]


def test_flow_is_legible(behind, open_page):
    watched = open_page(behind.address)
    watched.sign_in("coco", PASSWORD, STUDY)
    page = watched.page
    page.get_by_role("link", name="Flow", exact=True).click()
    page.wait_for_selector("text=Registered: 5")
    require_legible(page, "flow")
