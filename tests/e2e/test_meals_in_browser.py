"""The list of meals in a browser: followed in place, a food chosen by keyboard, files."""

import re

import pytest
from playwright.sync_api import expect

from tests.e2e.dashboard_server import PASSWORD
from tests.support import estimates
from tests.support.estimates import found_item, unmeasured_item
from tests.support.waiting import wait_until

MEALS = "/dashboard/studies/list/meals"
COUNT_POLLS = """
window.polls = { sent: 0, answered: 0 };
const count = (name) => ({ detail }) => { if (detail.ctx.sourceElement.id === "meals-watch") window.polls[name] += 1; };
addEventListener("htmx:before:request", count("sent"));
addEventListener("htmx:after:request", count("answered"));
"""


@pytest.fixture(scope="module")
def phone(served):
    served.make_study("list")
    served.make_staff("vic", list="viewer")
    with served.enrol("P001", "list") as phone:
        hints = [{"point": [30, 20], "food": "apple"}]
        served.send_meal(phone, found_item(), unmeasured_item(hint=None), hints=hints)
        item = found_item(90.0, hint=None, flags=["low_texture"])
        served.send_meal(phone, item, captured_at="2026-11-19T12:30:00+08:00")
        yield phone


@pytest.mark.slow
@pytest.mark.parametrize("view", ["gallery", "table"])
def test_meal_is_followed_in_its_place_and_the_focus_stays(served, phone, open_page, view):
    waiting = served.send_meal(phone, captured_at="2026-11-21T12:30:00+08:00")
    tab = open_page(served.address)
    tab.sign_in("vic", PASSWORD, f"{MEALS}?view={view}&status=queued")
    place, link = f"#meal-P001-{waiting}", f"#meal-P001-{waiting} :is(h3, th) a"
    tab.page.focus(link)
    tab.page.evaluate("document.activeElement.mark = 'same'")
    estimates.save(served, waiting, found_item(hint=None))
    tab.page.wait_for_selector(f"{place} .status-needs_review")
    wait_until(lambda: tab.page.evaluate("document.activeElement.mark") == "same", "the focus on the same link")
    expect(tab.page.locator(place)).to_have_count(1)
    expect(tab.page.locator("#meals-live")).to_contain_text("needs review")
    expect(tab.page.locator("#meals-watch:not([hx-get])")).to_have_count(1)
    tab.page.keyboard.press("Enter")
    tab.page.wait_for_url(f"**{MEALS}/P001/{waiting}")


@pytest.mark.slow
def test_meal_that_is_erased_leaves_the_page(served, phone, open_page):
    erased = served.send_meal(phone, captured_at="2026-11-09T12:30:00+08:00")
    tab = open_page(served.address)
    tab.expect("status of 410")  # its picture may be on its way as it goes
    tab.sign_in("vic", PASSWORD, MEALS)
    expect(tab.page.locator(f"#meal-P001-{erased}")).to_be_visible()
    others = tab.page.locator(".meal-card").count() - 1
    assert phone.delete(f"/v1/meals/{erased}").status_code == 200
    tab.page.wait_for_selector(f"#meal-P001-{erased}", state="detached")
    expect(tab.page.locator(".meal-card")).to_have_count(others)
    expect(tab.page.locator("#meals-live")).to_have_text("A meal of P001 no longer exists.")


def open_page_with_a_standing_clock(open_page, served):
    """A tab that counts its polls and whose clock stands unless it is told to run; the server's does not."""
    tab = open_page(served.address)
    tab.page.clock.install(time=0)
    tab.page.clock.pause_at(1000)
    tab.page.add_init_script(COUNT_POLLS)
    return tab


@pytest.mark.slow
def test_page_asks_less_and_less_often_until_something_changes(served, phone, open_page):
    waiting = [served.send_meal(phone, captured_at=f"2026-11-08T1{hour}:30:00+08:00") for hour in (1, 2)]
    tab = open_page_with_a_standing_clock(open_page, served)
    tab.sign_in("vic", PASSWORD, f"{MEALS}?status=queued&to=2026-11-08")

    def times_of_questions(ticks):
        """At which of so many ticks, four seconds each, the page asks."""
        times = []
        for tick in range(1, ticks + 1):
            before = tab.page.evaluate("polls.sent")
            tab.page.clock.run_for(4000)
            times += [4 * tick] if tab.page.evaluate("polls.sent") > before else []
            wait_until(lambda: tab.page.evaluate("polls.answered === polls.sent"), "the server's answer")
        return times

    assert times_of_questions(28) == [4, 8, 12, 16, 20, 24, 28, 32, 40, 56, 84, 112]
    estimates.save(served, waiting[0], found_item(hint=None))
    first, *others = times_of_questions(14)
    assert (first, others) == (28, list(range(32, 57, 4)))


@pytest.mark.slow
def test_tab_that_nobody_sees_does_not_ask(served, phone, open_page):
    served.send_meal(phone, captured_at="2026-11-10T12:30:00+08:00")
    tab = open_page_with_a_standing_clock(open_page, served)
    tab.sign_in("vic", PASSWORD, MEALS)
    ask = "document.getElementById('meals-watch').dispatchEvent(new CustomEvent('every'))"
    hide = "Object.defineProperty(document, 'hidden', {configurable: true, get: () => %s})"
    tab.page.evaluate(hide % "true")
    tab.page.evaluate(ask)
    tab.page.clock.run_for(5000)  # longer than between two polls
    assert tab.page.evaluate("polls.sent") == 0
    tab.page.evaluate(hide % "false")
    with tab.page.expect_response("**/changed-meals*") as answer:
        tab.page.evaluate(ask)
    assert answer.value.status == 204


def test_food_is_chosen_by_keyboard_and_stands_in_the_address_with_the_other_filters(served, phone, open_page):
    tab = open_page(served.address)
    tab.sign_in("vic", PASSWORD, f"{MEALS}?view=table")
    page = tab.page
    page.fill("#participant", "P001")
    page.focus("#meals-food")
    page.keyboard.insert_text("apple raw")  # in one go: else a list for fewer letters might be replaced under the keys
    page.wait_for_selector("#meals-foods [role=option]")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.locator("input[name=food]")).to_have_value(re.compile("."))
    chosen = page.input_value("input[name=food]")
    page.keyboard.press("Enter")
    page.wait_for_url("**food=*")
    assert page.url.split("?")[1].split("&") == ["view=table", "participant=P001", f"food={chosen}"]
    expect(page.locator(f"input[name=food][value='{chosen}']")).to_be_checked()
    page.click("text=Clear all")
    page.wait_for_url(f"**{MEALS}?view=table")
    with page.expect_download() as download:
        page.click(".meals-files a:has-text('CSV') >> nth=0")
    assert download.value.suggested_filename == "list_meals.csv"


def validation_message(page):
    return page.evaluate("document.querySelector('#meals-food').validationMessage")


@pytest.mark.slow
def test_words_of_which_no_food_was_chosen_are_not_dropped(served, phone, open_page):
    tab = open_page(served.address)
    tab.sign_in("vic", PASSWORD, MEALS)
    page = tab.page
    sent = []
    page.on("request", lambda request: sent.append(request.url) if request.is_navigation_request() else None)
    for words, sentence in (
        ("apple r", "Choose a food from the list."),
        ("qqqqq", "No food of the tables matches this."),
    ):
        page.fill("#meals-food", words)
        for press in (lambda: page.press("#meals-food", "Enter"), lambda: page.click("text=Show")):
            press()
            wait_until(lambda expected=sentence: validation_message(page) == expected, sentence)
            expect(page.locator("#meals-food[aria-invalid=true]")).to_be_focused()
    assert sent == []
    page.fill("#meals-food", "")
    with page.expect_navigation(url=re.compile(r".*/meals\??$")):
        page.click("text=Show")
    page.route("**/foods?list=*", lambda route: route.abort())
    tab.expect("ERR_FAILED")
    page.fill("#meals-food", "apple")
    page.press("#meals-food", "Enter")
    wait_until(lambda: "try again" in validation_message(page), "try again")
    page.unroute("**/foods?list=*")
    page.press("#meals-food", "Enter")
    page.wait_for_url("**food=apple")
