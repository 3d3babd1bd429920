"""Operate the capture page by taps, as a participant does, and check what must hold on every page."""

import re

from tests.e2e.browser import violations
from tests.e2e.dashboard_server import require
from tests.support import estimates
from tests.support.estimates import identified_item

TARGET_PX = 44
AXE = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}}


def capture_link(served, participant="P001", study="capture"):
    """The link of a new card."""
    return require(served.admin.post(f"/v1/studies/{study}/participants/{participant}/enrolment-codes"))["capture_url"]


def enrolled(served, tab):
    tab.page.goto(capture_link(served))
    tab.page.get_by_role("button", name="Photograph a meal").wait_for()
    return tab.page


def photograph(page):
    """A new meal, up to the question whether its photographs are good."""
    page.get_by_role("button", name="Photograph a meal").click()
    page.get_by_role("heading", name="First photograph").wait_for()
    both_photographs(page)


def first_photograph(page):
    """The left photograph by the shutter, up to the right one's preview."""
    page.get_by_role("button", name="Take the photograph").click()
    page.get_by_role("heading", name="Second photograph").wait_for()


def both_photographs(page):
    """Both photographs by the shutter, up to the question whether they are good."""
    first_photograph(page)
    page.get_by_role("button", name="Take the photograph").click()
    page.get_by_role("heading", name="Are both good?").wait_for()


def send(page):
    """Send the only meal of this phone; return its id once the server has it."""
    page.get_by_role("button", name="Send").click()
    page.wait_for_selector("li[data-state=sent]")
    return page.get_attribute("li[data-state=sent]", "data-meal")


def sent_meal(served, tab):
    """Enrol a phone, photograph a meal and send it; return its id."""
    photograph(enrolled(served, tab))
    return send(tab.page)


def open_estimated(served, page, meal):
    """Measure a meal that was sent, and open it."""
    estimates.save(served, meal, identified_item({"apple": 0.9}))
    page.click(f"li[data-meal='{meal}'] a")


def require_accessible(page):
    """No finding of axe, no target below 44 px, no scrolling sideways."""
    assert violations(page, **AXE) == []
    small = page.evaluate(
        """(least) => [...document.querySelectorAll("button, a, input, summary")]
      .filter((element) => element.checkVisibility())
      .map((element) => [element.outerHTML.slice(0, 80), element.getBoundingClientRect()])
      .filter(([, { width, height }]) => width > 0 && (height < least || width < least)).map(([html]) => html)""",
        TARGET_PX,
    )
    assert not small
    assert not re.search(r"null|undefined|NaN|\{\w+\}", page.inner_text("body"))
