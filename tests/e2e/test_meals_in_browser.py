"""The list of meals in a browser: followed in place, a food chosen by keyboard, files, no serious finding of axe."""

import re

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests import estimates
from tests.e2e.dashboard_server import PASSWORD, dashboard_server
from tests.estimates import found_item, unmeasured_item

pytestmark = pytest.mark.slow

MEALS = "/dashboard/studies/pilot/meals"


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = dashboard_server(tmp_path_factory.mktemp("meals-page"))
    server.make_study()
    server.make_staff("ann", pilot="viewer")
    yield server
    server.close()


@pytest.fixture(scope="module")
def phone(served):
    with served.enrol() as phone:
        hints = [{"point": [30, 20], "food": "apple"}]
        served.send_meal(phone, found_item(), unmeasured_item(hint=None), hints=hints)
        served.send_meal(
            phone, found_item(90.0, hint=None, flags=["low_texture"]), captured_at="2026-11-19T12:30:00+08:00"
        )
        yield phone


@pytest.mark.parametrize("view", ["gallery", "table"])
def test_meal_is_followed_in_its_place_and_the_focus_stays(served, phone, open_page, view):
    waiting = served.send_meal(phone, captured_at="2026-11-21T12:30:00+08:00")
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, f"{MEALS}?view={view}&status=queued")
    place, link = f"#meal-P001-{waiting}", f"#meal-P001-{waiting} :is(h3, th) a"
    tab.page.focus(link)
    tab.page.evaluate("document.activeElement.mark = 'same'")
    estimates.save(served, waiting, found_item(hint=None))
    tab.page.wait_for_selector(f"{place} .status-needs_review")
    assert tab.page.evaluate("document.activeElement.mark") == "same"
    assert tab.page.locator(place).count() == 1
    assert "needs review" in tab.page.text_content("#meals-live")
    assert tab.page.get_attribute("#meals-watch", "hx-get") is None
    tab.page.keyboard.press("Enter")
    tab.page.wait_for_url(f"**{MEALS}/P001/{waiting}")


def test_meal_that_is_erased_leaves_the_page(served, phone, open_page):
    erased = served.send_meal(phone, captured_at="2026-11-09T12:30:00+08:00")
    tab = open_page(served.address)
    tab.expect("status of 410")  # its picture may be on its way as it goes
    tab.sign_in("ann", PASSWORD, MEALS)
    assert tab.page.is_visible(f"#meal-P001-{erased}")
    others = tab.page.locator(".meal-card").count() - 1
    assert phone.delete(f"/v1/meals/{erased}").status_code == 200
    tab.page.wait_for_selector(f"#meal-P001-{erased}", state="detached")
    assert tab.page.locator(".meal-card").count() == others
    assert tab.page.text_content("#meals-live") == "A meal of P001 no longer exists."


def test_page_asks_less_and_less_often_until_something_changes(served, phone, open_page):
    waiting = [served.send_meal(phone, captured_at=f"2026-11-08T1{hour}:30:00+08:00") for hour in (1, 2)]
    tab = open_page(served.address)
    tab.page.clock.install(time=0)
    tab.page.clock.pause_at(1000)  # it goes on when it is told to
    tab.sign_in("ann", PASSWORD, f"{MEALS}?status=queued&to=2026-11-08")
    asked, answered = [], []
    tab.page.on("request", lambda request: asked.append(request.url) if "changed-meals" in request.url else None)
    tab.page.on("requestfinished", lambda request: answered.append(request.url) if request.url in asked else None)

    def times_of_questions(ticks):
        """At which of so many ticks, four seconds each, the page asks."""
        times = []
        for tick in range(1, ticks + 1):
            before = len(asked)
            tab.page.clock.run_for(4000)
            tab.page.wait_for_timeout(50)  # the page's clock stands, its server's does not
            while len(answered) < len(asked):
                tab.page.wait_for_timeout(20)
            times += [4 * tick] if len(asked) > before else []
        return times

    assert times_of_questions(28) == [4, 8, 12, 16, 20, 24, 28, 32, 40, 56, 84, 112]
    estimates.save(served, waiting[0], found_item(hint=None))
    first, *others = times_of_questions(14)
    assert (first, others) == (28, list(range(32, 57, 4)))


def test_tab_that_nobody_sees_does_not_ask(served, phone, open_page):
    served.send_meal(phone, captured_at="2026-11-10T12:30:00+08:00")
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, MEALS)
    asked = []
    tab.page.on("request", lambda request: asked.append(request.url) if "changed-meals" in request.url else None)
    ask = "document.getElementById('meals-watch').dispatchEvent(new CustomEvent('every'))"
    hide = "Object.defineProperty(document, 'hidden', {configurable: true, get: () => %s})"
    tab.page.evaluate(hide % "true")
    tab.page.evaluate(ask)
    tab.page.wait_for_timeout(5000)  # longer than between two questions
    assert asked == []
    tab.page.evaluate(hide % "false")
    with tab.page.expect_response("**/changed-meals*") as answer:
        tab.page.evaluate(ask)
    assert answer.value.status == 204


def test_food_is_chosen_by_keyboard_and_stands_in_the_address_with_the_other_filters(served, phone, open_page):
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, f"{MEALS}?view=table")
    page = tab.page
    page.fill("#participant", "P001")
    page.focus("#meals-food")
    page.keyboard.type("apple raw")
    page.wait_for_selector("#meals-foods [role=option]")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    chosen = page.input_value("input[name=food]")
    assert chosen
    page.keyboard.press("Enter")
    page.wait_for_url("**food=*")
    assert page.url.split("?")[1].split("&") == ["view=table", "participant=P001", f"food={chosen}"]
    assert page.is_checked(f"input[name=food][value='{chosen}']")
    page.click("text=Clear all")
    page.wait_for_url(f"**{MEALS}?view=table")
    with page.expect_download() as download:
        page.click(".meals-files a:has-text('CSV') >> nth=0")
    assert download.value.suggested_filename == "meals.csv"


def test_words_of_which_no_food_was_chosen_are_not_dropped(served, phone, open_page):
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, MEALS)
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
            page.wait_for_selector("#meals-food[aria-invalid=true]")
            assert page.evaluate("document.querySelector('#meals-food').validationMessage") == sentence
            assert page.evaluate("document.activeElement.id") == "meals-food"
    assert sent == []
    page.fill("#meals-food", "")
    with page.expect_navigation(url=re.compile(r".*/meals\??$")):
        page.click("text=Show")
    page.route("**/foods?list=*", lambda route: route.abort())
    tab.expect("ERR_FAILED")
    page.fill("#meals-food", "apple")
    page.press("#meals-food", "Enter")
    page.wait_for_selector("#meals-food[aria-invalid=true]")
    assert "try again" in page.evaluate("document.querySelector('#meals-food').validationMessage")
    page.unroute("**/foods?list=*")
    page.press("#meals-food", "Enter")
    page.wait_for_url("**food=apple")


@pytest.mark.parametrize("typed", ["name", "key"])
def test_exact_name_or_key_is_taken_without_a_choice(served, phone, open_page, typed):
    name = served.admin.get("/v1/foods/banana").json()["name"]
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, MEALS)
    tab.page.fill("#meals-food", name.upper() if typed == "name" else "banana")
    tab.page.press("#meals-food", "Enter")
    tab.page.wait_for_url(f"**{MEALS}?food=banana")
    assert tab.page.is_checked("input[name=food][value=banana]")


def test_without_scripts_a_key_is_typed_and_no_field_drops_words(served, phone, open_page):
    tab = open_page(served.address, java_script_enabled=False)
    tab.sign_in("ann", PASSWORD, MEALS)
    assert not tab.page.is_visible("#meals-food")
    tab.page.fill("#food", "apples")
    tab.page.press("#food", "Enter")
    tab.page.wait_for_url("**food=apples*")
    assert "No food of the tables has the key “apples”" in tab.page.inner_text("main")


@pytest.mark.parametrize("view", ["gallery", "table"])
@pytest.mark.parametrize("looks", ["light", "dark", "phone"])
def test_page_is_accessible(served, phone, open_page, looks, view):
    options = {"color_scheme": "dark"} if looks == "dark" else {}
    options |= {"viewport": {"width": 390, "height": 800}} if looks == "phone" else {}
    tab = open_page(served.address, **options)
    tab.sign_in("ann", PASSWORD, f"{MEALS}?view={view}&participant=P001&flag=low_texture&flag=not_measurable")
    assert tab.page.locator("[id^=meal-P001]").count() == 2
    found = Axe().run(tab.page).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []
    assert tab.page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
