"""The page of one meal in a browser: outlines and cards, a food searched by keyboard, an outline drawn, a conflict."""

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests import estimates
from tests.e2e.dashboard_server import PASSWORD
from tests.estimates import found_item, identified_item

pytestmark = pytest.mark.slow

SQUARE = [[200.0, 150.0], [300.0, 150.0], [300.0, 250.0], [200.0, 250.0]]


@pytest.fixture
def meal(served, phone):
    """A meal with a food that the server knows, and one that it does not."""
    known = identified_item({"apple": 0.9, "pear": 0.06}, none=0.04)
    unknown = identified_item({"peach": 0.4, "orange": 0.3}, none=0.3, polygon=SQUARE)
    return served.send_meal(phone, known, unknown)


@pytest.fixture
def opened(served, meal, open_page):
    """The meal's page, for a reviewer."""
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, f"/dashboard/studies/pilot/meals/P001/{meal}")
    return tab


def second(served, meal):
    return served.meal(meal)["items"][1]


def test_outline_and_card_light_up_together(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    page.hover(f"#item-{item} h3")
    assert page.locator(f'svg a[data-item="{item}"].lit').count() == 1
    page.focus(f'svg[data-photograph="left"] a[data-item="{item}"]')
    assert page.locator(f"#item-{item}.lit").count() == 1
    page.keyboard.press("Enter")
    assert page.url.endswith(f"#item-{item}")


def test_food_is_chosen_from_what_the_server_finds_by_keyboard_alone(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    page.focus(f"#change-{item} summary")
    page.keyboard.press("Enter")
    page.focus(f"#food-{item}")
    page.keyboard.type("bana")
    page.wait_for_selector(f"#food-{item}-list [role=option]")
    page.keyboard.press("ArrowDown")
    marked = page.get_attribute(f"#food-{item}", "aria-activedescendant")
    assert page.get_attribute(f"#{marked}", "aria-selected") == "true"
    page.keyboard.press("Enter")
    assert page.input_value(f"#food-{item}").startswith("Banana")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"#item-{item} .status-corrected")
    assert "Food: saved." in page.inner_text("#said")
    assert page.evaluate("document.activeElement.id") == f"item-{item}"
    assert "Banana" in page.inner_text(f"#name-{item}")
    assert second(served, meal)["food"]["name"].startswith("Banana")


def test_food_that_was_not_chosen_is_not_said_and_its_exact_name_is(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    before = second(served, meal)["food"]
    name = served.admin.get("/v1/foods/banana").json()["name"]
    page.click(f"#change-{item} summary")
    page.fill(f"#food-{item}", "bana")
    page.click(f"#change-{item} button:has-text('Set food')")
    page.wait_for_selector(f"#food-{item}[aria-invalid=true]")
    assert page.is_visible(f"#food-{item}-list [role=option]")
    assert second(served, meal)["food"] == before
    page.fill(f"#food-{item}", name)
    page.click(f"#change-{item} button:has-text('Set food')")
    page.wait_for_selector(f"#item-{item} .status-corrected")
    assert second(served, meal)["food"]["key"] == "banana"


def test_outline_is_drawn_by_keys_and_by_mouse(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    page.click(f"#change-{item} summary")
    page.focus(f"#change-{item} [data-draw-start]")
    page.keyboard.press("Enter")
    page.wait_for_selector("circle.corner:focus")
    before = page.input_value(f"#redraw-{item}-polygon").splitlines()
    assert len(before) == 4
    page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("+")
    after = page.input_value(f"#redraw-{item}-polygon").splitlines()
    x, y = (float(number) for number in before[0].split(","))
    assert (len(after), after[0]) == (5, f"{x - 10:.1f}, {y:.1f}")
    page.locator('svg[data-photograph="left"]').click(position={"x": 30, "y": 20})
    assert len(page.input_value(f"#redraw-{item}-polygon").splitlines()) == 6
    page.keyboard.press("Enter")
    assert page.locator("circle.corner").count() == 0
    page.keyboard.press("Enter")  # the form's button has the focus
    page.wait_for_selector(f"#item-{item} .flag >> text=remeasuring")
    assert len(second(served, meal)["polygon"][0]) == 6


def test_conflict_is_told_and_the_word_can_be_said_all_the_same(served, meal, opened):
    page, item = opened.page, second(served, meal)
    opened.expect("412")
    served.say(meal, "set_food", item=item["id"], food="orange")
    page.click(f"#change-{item['id']} summary")
    page.fill(f"#mass-{item['id']}", "120")
    page.click(f"#change-{item['id']} button:text('Set mass')")
    page.wait_for_selector("#conflict")
    told = page.inner_text("#conflict")
    assert "boss" in told
    assert "Orange" in told
    assert second(served, meal)["mass_g"] != 120.0
    page.click("#conflict button:text('Apply it nevertheless')")
    page.wait_for_selector("#conflict", state="detached")
    assert second(served, meal)["mass_g"] == 120.0


def test_what_was_said_is_taken_back(served, meal, opened):
    page, item = opened.page, served.meal(meal)["items"][0]["id"]
    page.click(f"#item-{item} button:text('Reject')")
    page.wait_for_selector(f"#item-{item} .status-rejected")
    page.click(".timeline button:text('Take back') >> nth=0")
    page.wait_for_selector(f"#item-{item} .status-proposed")
    assert served.meal(meal)["items"][0]["status"] == "proposed"


def test_page_follows_a_meal_and_keeps_what_is_being_typed(served, phone, open_page):
    waiting = served.send_meal(phone)
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, f"/dashboard/studies/pilot/meals/P001/{waiting}")
    assert "queued" in tab.page.inner_text("#meal-state")
    tab.page.fill("#talk-text", "half a sentence")
    estimates.save(served, waiting, found_item(hint=None))
    tab.page.wait_for_selector("#meal-state .status-needs_review")
    assert tab.page.locator("article.item").count() == 1
    assert tab.page.input_value("#talk-text") == "half a sentence"


def test_refused_value_is_told_and_kept(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    opened.expect("422")
    page.click(f"#change-{item} summary")
    page.fill(f"#volume-{item}", "a lot")
    page.click(f"#change-{item} button:text('Set volume')")
    page.wait_for_selector("#problem .refused")
    assert "Millilitres" in page.inner_text("#problem")
    assert page.input_value(f"#volume-{item}") == "a lot"


@pytest.mark.parametrize("looks", ["light", "dark", "phone"])
def test_page_is_accessible(served, meal, open_page, looks):
    options = {"color_scheme": "dark"} if looks == "dark" else {}
    options |= {"viewport": {"width": 390, "height": 800}} if looks == "phone" else {}
    tab = open_page(served.address, **options)
    tab.sign_in("ann", PASSWORD, f"/dashboard/studies/pilot/meals/P001/{meal}")
    for summary in tab.page.locator("main details > summary").all():
        summary.click()
    found = Axe().run(tab.page).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []
    assert tab.page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
