"""The page of one meal in a browser: outlines and cards, a food searched by keyboard, an outline drawn, a conflict."""

import re

import pytest
import sqlalchemy as sa
from playwright.sync_api import expect

from app.meals.stored.record_models import EffectiveRecord
from tests.e2e.dashboard_server import PASSWORD
from tests.support import estimates
from tests.support.estimates import found_item, identified_item

SQUARE = [[200.0, 150.0], [300.0, 150.0], [300.0, 250.0], [200.0, 250.0]]


STICKING_OUT = """() => {
  const ends = (part) => part.getBoundingClientRect().right;
  const isBeyond = (part, around) => around !== null && ends(part) > ends(around) + 1;
  return [...document.querySelectorAll("dd .num, td .num, td button")]
    .filter((part) => isBeyond(part, part.closest("dd, td"))
      || (!part.closest(".scroll") && isBeyond(part, part.closest("article"))))
    .map((part) => part.textContent);
}"""


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


def test_food_is_chosen_from_what_the_server_finds_by_keyboard_alone(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    page.focus(f"#change-{item} summary")
    page.keyboard.press("Enter")
    page.focus(f"#food-{item}")
    page.keyboard.insert_text("bana")  # in one go: else a list for fewer letters might be replaced under the keys
    page.wait_for_selector(f"#food-{item}-list [role=option]")
    page.keyboard.press("ArrowDown")
    marked = page.locator(f"#food-{item}[aria-activedescendant]").get_attribute("aria-activedescendant")
    expect(page.locator(f"#{marked}")).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Enter")
    expect(page.locator(f"#food-{item}")).to_have_value(re.compile("^Banana"))
    page.keyboard.press("Enter")
    page.wait_for_selector(f"#item-{item} .status-corrected")
    expect(page.locator("#said")).to_contain_text("Food: saved.")
    expect(page.locator(f"#item-{item}")).to_be_focused()
    expect(page.locator(f"#name-{item}")).to_contain_text("Banana")
    assert second(served, meal)["food"]["name"].startswith("Banana")


@pytest.mark.slow
def test_value_that_is_refused_and_food_that_was_not_chosen_are_not_said_and_its_exact_name_is(served, meal, opened):
    page, item = opened.page, second(served, meal)["id"]
    before = second(served, meal)["food"]
    name = served.admin.get("/v1/foods/banana").json()["name"]
    opened.expect("422")
    page.click(f"#change-{item} summary")
    page.fill(f"#volume-{item}", "a lot")
    page.click(f"#change-{item} button:text('Set volume')")
    expect(page.locator("#problem .refused")).to_be_visible()
    expect(page.locator("#problem")).to_contain_text("Millilitres")
    expect(page.locator(f"#volume-{item}")).to_have_value("a lot")
    page.fill(f"#food-{item}", "bana")
    page.click(f"#change-{item} button:has-text('Set food')")
    page.wait_for_selector(f"#food-{item}[aria-invalid=true]")
    expect(page.locator(f"#food-{item}-list [role=option]").first).to_be_visible()
    assert second(served, meal)["food"] == before
    page.fill(f"#food-{item}", name)
    page.click(f"#change-{item} button:has-text('Set food')")
    page.wait_for_selector(f"#item-{item} .status-corrected")
    assert second(served, meal)["food"]["key"] == "banana"


@pytest.mark.slow
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
    expect(page.locator("circle.corner")).to_have_count(0)
    page.keyboard.press("Enter")  # the form's button has the focus
    page.wait_for_selector(f"#item-{item} .flag >> text=remeasuring")
    assert len(second(served, meal)["polygon"][0]) == 6


@pytest.mark.slow
def test_page_follows_a_meal_and_keeps_what_is_being_typed(served, phone, open_page):
    waiting = served.send_meal(phone)
    tab = open_page(served.address)
    tab.sign_in("ann", PASSWORD, f"/dashboard/studies/pilot/meals/P001/{waiting}")
    expect(tab.page.locator("#meal-state")).to_contain_text("queued")
    tab.page.fill("#talk-text", "half a sentence")
    estimates.save(served, waiting, found_item(hint=None))
    tab.page.wait_for_selector("#meal-state .status-needs_review")
    expect(tab.page.locator("article.item")).to_have_count(1)
    expect(tab.page.locator("#talk-text")).to_have_value("half a sentence")


@pytest.mark.slow
@pytest.mark.parametrize(("high", "shown"), [(15e6, "0.50 to 15 000 000"), (1e147, "0.50 to 1.00e+147")])
def test_wide_interval_is_shown_as_it_is_and_stays_in_its_column(served, meal, opened, high, shown):
    with served.database.write() as session:
        for low, top in (("volume_low_ml", "volume_high_ml"), ("consumed_low_g", "consumed_high_g")):
            session.execute(sa.update(EffectiveRecord).values({low: 0.5, top: high}))
    for width in (1200, 390):
        opened.page.set_viewport_size({"width": width, "height": 900})
        for address in (f"meals/P001/{meal}", "review"):
            opened.goto(f"/dashboard/studies/pilot/{address}")
            expect(opened.page.locator("dd", has_text=shown).first).to_be_visible()
            opened.page.evaluate("document.querySelectorAll('article details').forEach((one) => { one.open = true; })")
            assert opened.page.evaluate(STICKING_OUT) == [], (width, address)
