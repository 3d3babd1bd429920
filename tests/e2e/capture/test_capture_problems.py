"""Errors on the capture page: whose fault the page says it is, and how long it says so."""

import re

import pytest
from playwright.sync_api import expect

from app.capture.files import STATIC
from tests.e2e.capture.capture_page import enrolled, photograph, sent_meal
from tests.e2e.static_modules import open_modules
from tests.support import estimates
from tests.support.estimates import identified_item

OF_THE_PHONE = "An error occurred on this phone (x is null). Please try again later."
BUSY = "The study's server cannot answer now. Please try again later."
REFUSAL = {"code": "invalid_input", "detail": "No such food.", "retryable": False}
BLURRED = {"code": "image_blurred", "severity": "warn", "side": "left", "message": "The left photo is blurred."}
END_OF_A_FORMER_TOKEN = """async () => {
  const { noteEnd } = await import("/capture/sender.js");
  const store = await import("/capture/store.js");
  const phone = await store.phone();
  await noteEnd({ code: "withdrawn", document: {} }, { ...phone, token: "former" });
  return (await store.phone())?.token === phone.token;
}"""
SENTENCES = """async (errors) => {
  const { loadTexts, sentenceOf } = await import("/texts.js");
  const t = await loadTexts("en");
  return [...errors, new TypeError("x is null"), new DOMException("x is null", "InvalidStateError")]
    .map((error) => sentenceOf(error, t));
}"""


def test_only_what_the_server_says_is_shown_as_the_server_s_words(open_page):
    tab = open_modules(open_page, STATIC)
    of_a_record = {"code": "internal", "detail": "x is null"}  # of a meal that waits
    errors = [REFUSAL, of_a_record | {"retryable": True}, of_a_record, {"code": "busy", "retryable": True}]
    sentences = tab.page.evaluate(SENTENCES, errors)
    assert sentences == [
        "The study's server says: No such food.",
        OF_THE_PHONE,
        OF_THE_PHONE,
        BUSY,
        *[OF_THE_PHONE] * 2,
    ]


@pytest.mark.slow
def test_why_a_change_failed_stays_on_the_page_when_the_meal_changes(served, open_phone):
    tab = open_phone(service_workers="block")  # a worker's requests cannot be routed
    tab.expect("status of 422|Service Worker registration blocked")
    page, meal = tab.page, sent_meal(served, tab)
    estimates.save(served, meal, identified_item({"apple": 0.9}))
    estimated = served.admin.get(f"/v1/meals/{meal}").json()
    document = estimated | {"status": "processing"}

    def answer(route):
        """The meal, if it is another than the page knows: one that is opened anew asks for all of it."""
        known = route.request.headers.get("if-none-match")
        if known == f'"{document["version"]}"':
            route.fulfill(status=304)
        else:
            route.fulfill(json=document)

    page.route(re.compile(rf"/v1/meals/{meal}(\?.*)?$"), answer)
    refusal = {"status": 422, "json": REFUSAL, "content_type": "application/problem+json"}
    page.route(f"**/v1/meals/{meal}/events", lambda route: route.fulfill(**refusal))
    page.click(f"li[data-meal='{meal}'] a")
    page.get_by_role("button", name="That is right").click()
    page.get_by_text("The study's server says: No such food.").wait_for()
    document = estimated | {"version": estimated["version"] + 1}
    page.get_by_role("button", name="Erase this meal").wait_for()  # shown once the meal is measured
    expect(page.get_by_text("The study's server says: No such food.")).to_be_visible()


@pytest.mark.slow
def test_form_that_is_sent_without_its_button_joins_too(open_phone):
    """As some keyboards and password managers send it: the event then names no button."""
    tab = open_phone()
    tab.expect("status of 404")
    tab.goto("/capture/")
    tab.page.get_by_label("Code on the card").fill("wrong")
    tab.page.evaluate('document.querySelector("form").requestSubmit()')
    tab.page.get_by_text("This code is not valid").wait_for()
    expect(tab.page.get_by_role("button", name="Join", exact=True)).to_be_enabled()


@pytest.mark.slow
def test_texts_that_the_server_could_not_give_are_asked_for_again(open_phone):
    tab = open_phone(service_workers="block")  # a worker's requests cannot be routed
    tab.expect("status of 503|Service Worker registration blocked")
    busy = {"status": 503, "json": {"code": "busy", "detail": "Busy."}, "content_type": "application/problem+json"}
    tab.page.route("**/texts/en.json", lambda route: route.fulfill(**busy), times=2)  # of the page, and of its error
    tab.goto("/capture/")
    tab.page.get_by_text("The server does not give the texts in en (503).").wait_for()
    tab.page.evaluate('location.hash = "another"')
    tab.page.get_by_role("button", name="Scan the card").wait_for()
    expect(tab.page.locator("#error")).to_be_hidden()


@pytest.mark.slow
def test_end_of_a_former_token_is_not_the_end_of_the_one_that_the_person_has_joined_with_since(served, open_phone):
    assert enrolled(served, open_phone()).evaluate(END_OF_A_FORMER_TOKEN)


@pytest.mark.slow
def test_pair_with_a_warning_is_not_called_good(served, open_phone):
    tab = open_phone(service_workers="block")  # a worker's requests cannot be routed
    tab.expect("Service Worker registration blocked")
    page = enrolled(served, tab)
    page.route("**/v1/checks", lambda route: route.fulfill(json={"ok": True, "problems": [BLURRED]}))
    photograph(page)
    page.get_by_text("The left photo is blurred.").wait_for()
    expect(page.get_by_text("The photographs are good.")).to_have_count(0)
