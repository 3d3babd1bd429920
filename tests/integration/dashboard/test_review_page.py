"""The review page: its figures are those of the API's queue, its events go through the API's use case."""

import html
import re
import uuid

import pytest

from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.records.reviewing import Speaker
from tests.support.estimates import found_item, identified_item, unmeasured_item

PAGE = "/dashboard/studies/pilot/review"
QUEUE = "/v1/studies/pilot/review-queue"
CARD = re.compile(r"<article class=\"card review-card\".*?</article>", re.DOTALL)
FIGURES = re.compile(r"<dl class=\"figures review-figures\">.*?</dl>", re.DOTALL)


def cards_of(page):
    return CARD.findall(page)


def attribute(card, name):
    return re.search(rf' data-{name}="([^"]*)"', card)[1]


def test_cards_are_the_queue_of_the_api_figure_by_figure(client, admin, meal_of, sign_in_browser):
    meal_of(identified_item({"apple": 0.6, "pear": 0.25}, none=0.1), hint=None)
    meal_of(found_item(90.0, relative_sd={"pair": 0.0, "item": 0.2}))
    meal_of(unmeasured_item())
    rows = client.get(QUEUE, headers=admin).json()["items"]
    cards = cards_of(sign_in_browser("ann", pilot="reviewer").page(PAGE))
    assert [attribute(card, "item") for card in cards] == [row["item"] for row in rows]
    for card, row in zip(cards, rows, strict=True):
        meal = client.get(row["meal_href"], headers=admin).json()
        (item,) = meal["items"]
        energy = next((each["interval"] for each in item["nutrients"] if each["number"] == "208"), None)
        shown = figures_of(FIGURES.search(card)[0])
        told = [
            (row["volume_ml"], row["volume_interval_ml"]),
            (row["mass_g"], row["mass_interval_g"]),
            (row["consumed_g"], row["consumed_interval_g"]),
            (row["energy_kcal"], energy),
        ]
        wanted = [number for value, both in told for number in ([value, *both] if value is not None else [])]
        assert shown == pytest.approx(wanted, rel=1e-12)
        assert row["doubt"] in figures_of(card)
        assert attribute(card, "version") == row["etag"].strip('"')
        chances = [one["probability"] for one in row["candidates"] if one["probability"] is not None]
        assert set(chances) <= set(figures_of(card))


def test_food_is_marked_if_it_is_likelier_than_none_of_these(meal_of, enrol, sign_in_browser):
    enrol()
    browser = sign_in_browser("ann", pilot="reviewer")
    for number, (hint, probabilities, none, marked, why) in enumerate(
        (
            (None, {"pear": 0.3, "apple": 0.2}, 0.29, "pear", None),
            (None, {"pear": 0.3, "apple": 0.2}, 0.3, None, "Probably none of these"),
            (None, {}, 1.0, None, None),
            ("apple", {"pear": 0.2}, 0.7, "apple", None),  # of a food that it does not know the index says nothing
            ("apple", {"pear": 0.97}, 0.01, None, "The phone and the server disagree"),
        )
    ):
        person = f"P{number}"
        item = identified_item(probabilities, none=none, hint=0 if hint else None)
        meal_of(item, participant=person, hint=hint)
        (card,) = cards_of(browser.page(PAGE, participant=person))
        assert re.findall(r'<button name="food" value="(\w+)"[^>]*\sdata-marked', card) == ([marked] if marked else [])
        assert re.findall(r'\sdata-unmarked="([^"]*)"', card) == ([why] if why else [])
        assert ("Probably none of these" in text_of(card)) is (why == "Probably none of these")


def test_filters_and_pages_are_those_of_the_api(client, admin, meal_of, sign_in_browser):
    for number in range(14):
        meal_of(found_item(100.0 + number), participant=f"P00{number % 2 + 1}")
    browser = sign_in_browser("ann", pilot="reviewer")
    rows = client.get(QUEUE, headers=admin).json()["items"]
    first = browser.page(PAGE)
    assert "14 items need a look" in text_of(first)
    part = browser.get(html.unescape(attribute(first, "more")), headers={"HX-Request": "true"}).text
    assert "<html" not in part
    assert [attribute(card, "item") for card in cards_of(first) + cards_of(part)] == [row["item"] for row in rows]
    of_one = cards_of(browser.page(PAGE, participant="P002", status="", food="", min_doubt="", provisional=""))
    assert {attribute(card, "who") for card in of_one} == {"P002"}
    assert len(of_one) == 7
    assert "No item with these filters waits for a reviewer" in browser.page(PAGE, food="banana")
    assert browser.get(PAGE, min_doubt="2").status_code == 422


def test_event_of_another_reviewer_is_shown_with_the_current_item(client, admin, meal_of, enrol, sign_in_browser):
    meal = meal_of(found_item(), found_item(90.0))
    enrol("P009", study="other")
    browser = sign_in_browser("ann", pilot="reviewer", other="owner")
    first, second = cards_of(browser.page(PAGE))
    path = attribute(first, "again")
    again = {"item": attribute(first, "item"), "seen": attribute(first, "seen")}
    assert browser.get(path.replace("/pilot/", "/other/"), **again).status_code == 404
    assert browser.get(path, **again | {"item": str(uuid.uuid4())}).status_code == 404
    assert "data-settled" not in browser.page(path, **again)
    speaker = Speaker(client, admin, meal)
    speaker.say("set_mass", item=attribute(second, "item"), mass_g=77)
    card = browser.page(path, **again)
    assert "admin set the amount: 77 g (of another item)" in text_of(card)
    assert "data-settled" not in card
    assert int(attribute(card, "version")) == int(attribute(first, "version")) + 1
    speaker.say("comment", item=again["item"], text='<script>alert(1)</script>"><img src=x onerror=alert(1)>')
    speaker.say("set_food", item=again["item"], food="pear")
    card = browser.page(path, **again)
    assert "admin set the food: pear" in text_of(card)
    assert "data-settled" in card
    assert "<script>alert" not in card
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in card
    assert "<img src=x" not in card


def test_own_event_does_not_settle_the_readers_card(meal_of, sign_in_browser):
    meal_of(found_item())
    browser = sign_in_browser("ann", pilot="reviewer")
    (card,) = cards_of(browser.page(PAGE))
    fields = {"id": str(uuid.uuid4()), "kind": "set_food", "item": attribute(card, "item"), "food": "pear"}
    fields |= {"version": attribute(card, "version"), "seen": attribute(card, "seen")}
    answer = browser.post(attribute(card, "events"), headers={"Accept": "application/json"}, **fields)
    assert answer.status_code == 201
    again = browser.page(attribute(card, "again"), item=fields["item"], seen=fields["seen"])
    assert "You set the food: pear" in text_of(again)
    assert "data-settled" not in again
    stale = fields | {"id": str(uuid.uuid4()), "kind": "confirm"}
    stale.pop("food")
    refused = browser.post(attribute(card, "events"), headers={"Accept": "application/json"}, **stale)
    assert (refused.status_code, refused.json()["code"]) == (412, "precondition_failed")
    assert cards_of(browser.get(PAGE).text) == []
