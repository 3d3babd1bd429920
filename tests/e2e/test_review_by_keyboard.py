"""Items reviewed by keyboard alone, in a real browser: at most two keys each, undo, others' words, no network."""

import math
import re

import pytest
from playwright.sync_api import expect

from tests.e2e.browser import violations
from tests.e2e.dashboard_server import PASSWORD, require
from tests.support.estimates import found_item, identified_item, unmeasured_item

CARD = ".review-card:not([hidden])"
SETTLED_MS = 170  # a key that comes sooner after an item was shown is taken for one that was meant for the item before
LIKELY = {"apple": 0.93, "pear": 0.04}  # the server takes it for an apple
UNSURE = {"pear": 0.5, "apple": 0.4}  # it does not say what it is
UNLIKELY = {"pear": 0.25, "apple": 0.2}, 0.55  # none of them is likelier


@pytest.fixture
def queue_of(served, open_page):
    """A reviewer at the queue of a study of its own, with a meal an item."""

    def queue_of(study, *items, hints=None, **options):
        served.make_study(study)
        served.make_staff(f"ann-{study}", **{study: "reviewer"})
        with served.enrol("P001", study) as phone:
            meals = [served.send_meal(phone, item, hints=hints or [{"point": [300, 200]}]) for item in items]
        watched = open_page(served.address, **options)
        watched.page.clock.install()
        watched.sign_in(f"ann-{study}", PASSWORD, f"/dashboard/studies/{study}/review")
        watched.page.wait_for_selector(CARD)
        return Reviewer(watched, served, meals), meals

    return queue_of


class Reviewer:
    """Somebody who presses keys and sees one item."""

    def __init__(self, watched, served, meals):
        self.watched, self.page, self.served, self.meals = watched, watched.page, served, meals
        self.keys = 0

    def shown(self):
        card = self.page.query_selector(CARD)
        return card.get_attribute("data-item") if card is not None else None

    def expect(self, selector, text):
        """Expect that the page shows this text there, soon."""
        expect(self.page.locator(selector)).to_be_visible()
        expect(self.page.locator(selector)).to_contain_text(text, use_inner_text=True)

    def expect_status(self, text):
        expect(self.page.locator("[data-status]")).to_have_text(text)

    def press(self, *keys):
        """Keys that do not go on to the next item."""
        self.page.clock.run_for(SETTLED_MS)
        for key in keys:
            self.page.keyboard.press(key)
            self.keys += 1

    def decide(self, *keys):
        """Keys after which another item is shown, or the end."""
        before = self.page.wait_for_selector(CARD).get_attribute("data-item")
        self.press(*keys)
        self.page.wait_for_function(
            "([card, before]) => (document.querySelector(card)?.dataset.item ?? null) !== before", arg=[CARD, before]
        )
        return before

    def saved(self):
        """Wait until nothing is on its way."""
        self.page.wait_for_function("() => !document.querySelector('[data-position]').textContent.includes('aving')")

    def item(self, meal):
        (item,) = self.served.meal(meal)["items"]
        return item


def round_item(probabilities, number=0, none=0.02, **changes):
    """An item in the middle of the photograph (640 x 480)."""
    ring = [[300 + 60 * math.cos(i * math.tau / 40), 200 + 50 * math.sin(i * math.tau / 40)] for i in range(40)]
    return identified_item(probabilities, none=none, volume_ml=150.0 + number, polygon=ring, **changes)


def test_items_take_one_key_each_and_the_next_is_there_with_its_picture(queue_of):
    items = [round_item(LIKELY if number % 2 else UNSURE, number) for number in range(14)]
    ann, meals = queue_of("keys", *items)
    page_behind = ann.page.get_attribute("[data-review]", "data-more")
    # the page behind has the number left as of its reading: it waits until all that was decided is saved
    let_go = hold(ann.page, lambda address: address.endswith(page_behind))
    reviewed = []
    for _ in range(10):
        assert ann.page.evaluate(f"document.activeElement === document.querySelector('{CARD}')")
        assert ann.page.get_attribute(f"{CARD} .review-crop image", "href")
        reviewed.append(ann.decide("Enter"))
    assert ann.keys == 10
    ann.saved()
    by_item = {ann.item(meal)["id"]: ann.item(meal) for meal in meals}
    for one in reviewed:
        assert by_item[one]["reviewed"]
        assert by_item[one]["food"]["key"] == by_item[one]["candidates"][0]["food"]["key"]
        assert by_item[one]["status"] in ("confirmed", "corrected")
    assert sum(item["reviewed"] for item in by_item.values()) == 10
    let_go()
    ann.expect("[data-position]", "about 4 left")
    for _ in range(4):  # those of the page behind
        ann.decide("y")
    ann.expect("[data-end]", "The end of the queue")
    ann.saved()
    assert all(ann.item(meal)["reviewed"] for meal in meals)


@pytest.mark.slow
def test_reflex_takes_no_candidate_where_none_is_likely_and_two_keys_take_the_first(queue_of):
    probabilities, none = UNLIKELY
    ann, meals = queue_of("unlikely", *[round_item(probabilities, number, none=none) for number in range(4)])
    first = ann.shown()
    assert ann.page.query_selector(f"{CARD} .choice.marked") is None
    ann.expect(CARD, "Probably none of these: 55.0")
    ann.press("Enter", "y", "Enter")
    ann.expect_status("Probably none of these: choose by number, or search (/).")
    assert ann.shown() == first
    assert not ann.item(meals[0])["reviewed"]
    by_keys = {}
    for keys in (("1",), ("ArrowDown", "Enter"), ("ArrowUp", "Enter")):
        ann.keys = 0
        by_keys[keys] = ann.decide(*keys)
        assert ann.keys <= 2
    ann.page.uncheck("[data-shortcuts-on]")
    ann.page.focus(CARD)
    ann.press("Enter")
    ann.expect_status("Probably none of these: choose by arrow keys, or search.")
    by_keys["no letters"] = ann.decide("ArrowDown", "ArrowDown", "Enter")
    ann.saved()
    foods = {ann.item(meal)["id"]: ann.item(meal)["food"]["key"] for meal in meals}
    assert [foods[item] for item in by_keys.values()] == ["pear", "pear", "apple", "apple"]


def hold(page, pattern):
    """Requests to these addresses wait from now on, until what this returns is called."""
    held = []
    is_open = False

    def take(route):
        if is_open:
            route.continue_()
        else:
            held.append(route)

    def let_go():
        nonlocal is_open
        is_open = True
        for route in held:
            route.continue_()

    page.route(pattern, take)
    return let_go


@pytest.mark.slow
def test_food_is_said_and_not_confirmed_while_the_card_is_not_as_it_was_shown(queue_of):
    ann, meals = queue_of("undone", round_item(LIKELY), round_item(LIKELY, 1))
    pear = ann.decide("2")
    let_go = hold(ann.page, "**/review/P001/**")
    ann.press("u")
    assert ann.shown() == pear
    ann.decide("2")  # the server has it as an apple again, and the card has not been read anew
    let_go()
    ann.saved()
    items = {ann.item(meal)["id"]: ann.item(meal) for meal in meals}
    assert items[pear]["food"]["key"] == "pear"


def test_candidate_mass_rejection_and_search_are_said_as_pressed_and_undone(queue_of):
    ann, meals = queue_of("words", *[round_item(UNSURE, number) for number in range(5)])
    said = {}
    said["second"] = ann.decide("2")
    said["next"] = ann.decide("n", "Enter")
    said["rejected"] = ann.decide("x")
    ann.press("f")
    ann.page.keyboard.insert_text("banan")  # in one go: else a list for fewer letters might come first
    ann.page.wait_for_selector('#review-foods [aria-selected="true"]')
    said["found"] = ann.decide("Enter")
    ann.press("m")
    ann.page.keyboard.type("120,5")
    said["weighed"] = ann.shown()
    ann.press("Enter")
    ann.page.wait_for_selector('[data-editor="food"]:not([hidden])')  # its food is not known yet
    ann.page.keyboard.press("Escape")
    assert ann.decide("Enter") == said["weighed"]
    ann.saved()
    by_item = {ann.item(meal)["id"]: ann.item(meal) for meal in meals}
    foods = {name: by_item[item]["food"]["key"] for name, item in said.items() if name != "rejected"}
    assert foods == {"second": "apple", "next": "apple", "found": "banana", "weighed": "pear"}
    assert (by_item[said["weighed"]]["mass_g"], by_item[said["rejected"]]["status"]) == (120.5, "rejected")
    for item in (said["weighed"], said["found"], said["rejected"]):
        ann.press("u")
        ann.page.wait_for_selector(f'{CARD}[data-item="{item}"]')
    ann.page.wait_for_function("() => document.querySelector('[data-status]').textContent.startsWith('Undone')")
    ann.saved()
    by_item = {ann.item(meal)["id"]: ann.item(meal) for meal in meals}
    assert [name for name, item in said.items() if by_item[item]["reviewed"]] == ["second", "next"]


@pytest.mark.slow
def test_item_whose_meal_changed_comes_back_with_who_said_what(queue_of, served):
    ann, meals = queue_of("conflict", *[round_item(LIKELY, number) for number in range(3)])
    ann.watched.expect("status of 412")
    first = ann.shown()
    of = {ann.item(meal)["id"]: meal for meal in meals}
    served.say(of[first], "comment", text='<b>Is this</b> "one" apple?', item=first)
    assert ann.decide("Enter") == first
    ann.page.wait_for_selector("[data-notices] .refused")
    ann.expect("[data-notices]", "Not saved: confirm")
    assert not ann.item(of[first])["reviewed"]
    second = ann.decide("Enter")
    ann.page.wait_for_selector(f'{CARD}[data-item="{first}"] [data-said]')
    ann.expect(f"{CARD} [data-said]", 'boss wrote a comment: <b>Is this</b> "one" apple?')
    third = next(item for item in of if item not in (first, second))
    served.say(of[third], "set_food", food="pear", item=third)
    assert ann.decide("Enter") == first
    ann.decide("Enter")
    ann.expect("[data-notices]", "was settled by somebody else. boss set the food: pear")
    ann.saved()
    assert ann.item(of[first])["status"] == "confirmed"
    assert ann.item(of[third])["food"]["key"] == "pear"
    ann.expect("[data-end]", "The end of the queue")


@pytest.mark.slow
def test_decision_without_a_network_comes_back_and_is_not_lost(queue_of):
    ann, meals = queue_of("line-down", *[round_item(LIKELY, number) for number in range(2)])
    ann.watched.expect("ERR_INTERNET_DISCONNECTED")
    ann.page.context.set_offline(True)
    first = ann.decide("Enter")
    ann.page.wait_for_selector("[data-notices] .refused")
    ann.expect("[data-notices]", "The server does not answer")
    # the card was read anew in vain: were it read later, keys for it would count as too early
    ann.page.wait_for_selector(f'[data-item="{first}"] [data-problem] .refused', state="attached")
    ann.page.context.set_offline(False)
    ann.decide("s")
    assert ann.shown() == first
    ann.decide("Enter")
    ann.saved()
    assert [ann.item(meal)["reviewed"] for meal in meals].count(True) == 1
    ann.expect("[data-end]", "1 item was skipped")
    ann.press("Enter")  # a new round
    ann.page.wait_for_selector(CARD)
    assert ann.shown() != first


@pytest.mark.slow
def test_amount_that_can_hardly_be_is_asked_about_and_saved_if_it_is_meant(queue_of):
    ann, meals = queue_of("amounts", *[found_item() for _ in range(2)], hints=[{"point": [300, 200], "food": "apple"}])
    ann.watched.expect("status of 422")
    ann.page.once("dialog", lambda dialog: dialog.accept())
    ann.press("m")
    ann.page.keyboard.type("15000")
    with ann.page.expect_event("dialog") as asked:
        meant = ann.decide("Enter")
    assert "Is the amount right?" in asked.value.message
    ann.saved()
    items = {ann.item(meal)["id"]: ann.item(meal) for meal in meals}
    assert (items[meant]["mass_g"], items[meant]["reviewed"]) == (15000.0, True)


def test_item_without_an_amount_asks_for_it_once_its_food_is_chosen(queue_of):
    ann, (meal,) = queue_of("amount", unmeasured_item(), hints=[{"point": [300, 200], "food": "apple"}])
    before = ann.served.meal(meal)["version"]
    ann.press("Enter")
    ann.page.wait_for_selector('[data-editor="mass"]:not([hidden])')
    ann.saved()
    assert ann.served.meal(meal)["version"] == before  # half a decision is none
    ann.page.keyboard.type("88")
    ann.decide("Enter")
    ann.saved()
    assert (ann.item(meal)["mass_g"], ann.item(meal)["food"]["key"]) == (88.0, "apple")


@pytest.mark.slow
def test_letters_can_be_switched_off_and_every_key_has_a_button(queue_of):
    ann, (meal,) = queue_of("letters", round_item(LIKELY))
    ann.press("?")
    ann.expect("[data-help]", "Undo the last decision")
    ann.press("x", "Escape")
    ann.page.uncheck("[data-shortcuts-on]")
    ann.page.focus(CARD)
    ann.press("x", "s", "1", "u", "?")
    expect(ann.page.locator('[data-do="reject"]')).not_to_have_attribute("aria-keyshortcuts", re.compile(""))
    expect(ann.page.locator("[data-help]")).to_be_hidden()
    assert ann.item(meal)["status"] == "proposed"
    ann.page.click('[data-do="reject"]')
    ann.page.wait_for_selector("[data-end]:not([hidden])")
    ann.saved()
    assert ann.item(meal)["status"] == "rejected"


@pytest.mark.slow
def test_editors_are_accessible_and_names_with_html_stay_text(queue_of, served):
    name = '<script>alert(1)</script> "pie"'
    food = {"key": "pie-axe", "name": name, "group": "Baked Products", "form": "slab", "reason": "a test"}
    require(served.admin.post("/v1/foods", json=food | {"nutrients": {}}))
    hints = [{"point": [300, 200], "food": "pie-axe"}]
    ann, _ = queue_of("axe", found_item(), round_item(UNSURE), color_scheme="dark", hints=hints)
    assert name in ann.page.inner_text(".review-card h2 >> nth=0") + ann.page.inner_text(".review-card h2 >> nth=1")
    for key, opened in (("f", "#review-food:visible"), ("d", ".drawing"), ("?", "dialog[open]")):
        ann.page.keyboard.press("Escape")
        ann.press(key)
        ann.page.wait_for_selector(opened)
        serious = [found for found in violations(ann.page) if found[1] in ("serious", "critical")]
        assert serious == [], key
