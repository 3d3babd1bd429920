"""Two reviewers decide items without seeing each other; a third settles where they differ; known items are mixed in."""

import base64
import csv
import io
import re
import uuid
from functools import partial

import pytest
import sqlalchemy as sa

from app.meals.stored.decision_models import ReviewDecision
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.caller import StaffCaller
from app.people.models import Staff, Study
from app.records.double_review.decide import BlindReview
from app.records.double_review.drawn import is_blind
from app.records.double_review.known_items import known_item_id
from app.records.double_review.schemas import DecisionIn
from app.records.double_review.study_agreement import known_agreement
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.people.people import make_staff
from tests.integration.records.at_once import at_once
from tests.integration.records.eating import eaten
from tests.integration.records.reviewing import Speaker
from tests.support.estimates import found_item
from tests.support.photographs import pair
from tests.support.two_reviewers import made_study

BLIND, AGREEMENT = "/dashboard/studies/pilot/blind", "/dashboard/studies/pilot/agreement"
SETTLE = f"{BLIND}?differing=true"
ALL = {"seed": 7, "share": 1, "limit_percent": 20}
STUDY = "/v1/studies/pilot"


@pytest.fixture
def protocol(client, admin):
    """Set the study's protocol of double review."""

    def protocol(**fields):
        body = {"double_review": ALL | fields}
        tag = client.get(STUDY, headers=admin).headers["etag"]
        answer = client.patch(STUDY, headers=admin | {"If-Match": tag}, json=body)
        assert answer.status_code == 200, answer.text

    return protocol


@pytest.fixture
def reviewers(phone, sign_in_browser, protocol):
    """ann and bob, who decide, and cid, who settles; each item of the study is decided by two."""
    protocol()
    return [sign_in_browser(name, pilot="reviewer") for name in ("ann", "bob", "cid")]


def shown(browser, **params):
    """The item that the page shows; None: none."""
    match = re.search(r'name="item" value="([^"]+)"', browser.page(BLIND, **params))
    return match[1] if match else None


def decide(browser, item=None, food="apple", mass_g="150", path=BLIND, **fields):
    """Send the page's form; returns the decision's id."""
    fields = {"item": item or shown(browser), "choice": food, "mass_g": mass_g, **fields}
    answer = browser.post(path, **fields)
    assert answer.status_code == 303, text_of(answer.text)[:500]
    return answer.headers["location"].rpartition("last=")[2]


def refusal(browser, path=BLIND, **fields):
    answer = browser.post(path, **fields)
    assert answer.status_code >= 400
    return answer.status_code, text_of(answer.text)


@pytest.mark.both_stores
def test_items_that_agree_get_the_mean_and_those_that_differ_wait_for_a_third(phone, state, client, admin, reviewers):
    ann, bob, cid = reviewers
    near, far, other, none = (Speaker(client, admin, eaten(phone, state, seed=seed)) for seed in range(4))
    item_ids = [meal.items()[0]["id"] for meal in (near, far, other, none)]
    for browser, grams in ((ann, "100"), (bob, "120")):
        decide(browser, item_ids[0], mass_g=grams)
    for browser, grams in ((ann, "100"), (bob, "130")):
        decide(browser, item_ids[1], mass_g=grams)
    for browser, food in ((ann, "apple"), (bob, "pear")):
        decide(browser, item_ids[2], food=food)
    for browser in (ann, bob):
        decide(browser, item_ids[3], reject="true")
    (item,) = near.items()
    assert (item["food"]["key"], item["mass_g"], item["status"], item["reviewed"]) == ("apple", 110, "corrected", True)
    assert none.items()[0]["status"] == "rejected"
    assert [event["kind"] for event in near.history()["items"]] == ["set_food", "set_mass"]
    assert [each.items()[0]["reviewed"] for each in (far, other)] == [False, False]
    assert {shown(browser, differing="true") for browser in (ann, bob)} == {None}
    assert "ann: apple, 100" in text_of(cid.page(BLIND, differing="true")) or "bob: pear" in text_of(
        cid.page(BLIND, differing="true")
    )
    assert shown(cid) is None
    decide(cid, item_ids[1], mass_g="127", path=SETTLE)
    assert (far.items()[0]["mass_g"], far.history()["items"][-1]["author"]) == (127, "cid")
    assert shown(cid, differing="true") == item_ids[2]
    assert refusal(cid, item=item_ids[1], choice="apple", mass_g="1")[0] == 404


def test_nothing_that_the_other_can_ask_tells_of_a_decision(phone, state, client, admin, reviewers):
    """Bob asks everything, ann decides, and bob gets the same bytes; so does a viewer, and the participant."""
    ann, bob, cid = reviewers
    meals = [eaten(phone, state, seed=seed) for seed in range(3)]
    items = [Speaker(client, admin, meal).items()[0]["id"] for meal in meals]
    meal = f"/v1/meals/{meals[0]}"
    calls = [
        *(
            meal,
            f"{meal}/events",
            "/v1/meals?study=pilot",
            "/v1/records?study=pilot",
            "/v1/records?study=pilot&format=csv",
        ),
        *(f"{STUDY}/review-queue", f"{STUDY}/changes", f"{STUDY}/changed-meals", f"{STUDY}/decisions"),
        *(f"{STUDY}/meal-counts", f"{STUDY}/photographs", f"{STUDY}/releases", f"{STUDY}/exports", STUDY),
    ]
    pages = [
        *(f"/dashboard/studies/pilot/meals/P001/{meals[0]}", "/dashboard/studies/pilot/meals", AGREEMENT),
        *(f"{AGREEMENT}?format=csv", BLIND, f"{BLIND}?differing=true", "/dashboard/studies/pilot/review"),
        *(f"{BLIND}?skip={item}" for item in items),
        f"{BLIND}?day=2026-11-20",
    ]
    token = make_staff(client, admin, "bob-by-token", pilot="reviewer").headers

    def asked():
        answers = [client.get(call, headers=headers) for call in calls for headers in (token,)]
        answers += [client.get(call, headers=phone.headers) for call in (meal, f"{meal}/events", "/v1/records")]
        answers += [browser.get(page) for page in pages for browser in (bob, cid)]
        assert {answer.status_code for answer in answers} == {200}
        new_id = re.compile(rb'name="id" value="[^"]*"')  # of a form's event, anew each time
        return [(new_id.sub(b"", answer.content), answer.headers.get("etag")) for answer in answers]

    before, study_before = asked(), study_of(state).change_seq
    decision = decide(ann, items[0], mass_g="123.25")
    decide(ann, items[1], reject="true")
    assert asked() == before
    assert study_of(state).change_seq == study_before
    assert ann.post(f"{BLIND}/{decision}/undo").status_code == 303
    assert asked() == before
    assert bob.post(f"{BLIND}/{decision}/undo").status_code == 404
    for picture in (items[0], items[1]):
        assert bob.get(f"{BLIND}/{picture}/picture").headers.get("etag") is None
    decide(bob, items[1], reject="true")
    assert asked() != before


def study_of(state):
    with state.database.read() as session:
        return session.scalars(sa.select(Study).where(Study.code == "pilot")).one()


def test_reviewers_cannot_decide_a_drawn_item_elsewhere_until_it_is_settled(phone, state, client, admin, reviewers):
    ann, bob, _ = reviewers
    meal = Speaker(client, make_staff(client, admin, "eve", pilot="reviewer").headers, eaten(phone, state))
    participant, item = Speaker(client, phone.headers, meal.meal_id), meal.items()[0]["id"]
    assert client.get(f"{STUDY}/review-queue", headers=admin).json()["items"] == []
    for kind, fields in (("confirm", {"item": item}), ("set_mass", {"item": item, "mass_g": 5}), ("confirm_meal", {})):
        assert meal.refused(kind, **fields) == (409, "item_blind")
    meal.say("comment", text="Is the peel in it?")
    participant.say("set_mass", item=item, mass_g=99)
    decide(ann)
    decide(bob)
    meal.say("set_mass", item=item, mass_g=5)
    assert meal.items()[0]["mass_g"] == 5


def test_decision_is_undone_until_its_item_is_settled_and_made_once(phone, state, client, admin, reviewers):
    ann, bob, cid = reviewers
    eaten(phone, state)
    item = shown(ann)
    first = decide(ann, item)
    assert shown(ann) is None
    assert refusal(ann, item=item, choice="pear", mass_g="2")[0] == 409
    assert ann.post(f"{BLIND}/{first}/undo").status_code == 303
    assert shown(ann) == item
    decide(ann, item, food="pear", mass_g="2")
    of_bob = decide(bob, item, food="apple")
    assert shown(cid, differing="true") == item
    assert refusal(cid, item=item, choice="pear", mass_g="3")[0] == 404  # without having seen the two
    assert bob.post(f"{BLIND}/{of_bob}/undo").status_code == 303
    assert refusal(cid, path=SETTLE, item=item, choice="pear", mass_g="3")[0] == 404
    decide(bob, item, food="apple")
    rows = list(csv.DictReader(io.StringIO(ann.page(AGREEMENT, format="csv"))))
    assert [(row["reviewer"], row["food_key"], row["settled_at"]) for row in rows] == [
        ("ann", "pear", ""),
        ("bob", "apple", ""),
    ]
    listed = client.get(f"{STUDY}/decisions", headers=admin).json()["items"]
    assert [(row["reviewer"], row["mass_g"]) for row in listed] == [("ann", 2), ("bob", 150)]
    actions = [row["action"] for row in client.get(f"{STUDY}/audit", headers=admin).json()["items"]]
    assert (actions.count("item.decide"), actions.count("item.undecide")) == (4, 2)


@pytest.mark.both_stores
def test_share_and_strata_draw_the_same_items_each_time(phone, state, protocol):
    for seed in range(40):
        eaten(phone, state, found_item(), found_item(120.0 + seed), seed=0)

    def drawn():
        with state.database.read() as session:
            study = session.scalars(sa.select(Study)).one()
            return set(session.scalars(sa.select(EffectiveRecord.item_id).where(is_blind(study))))

    sets = {}
    for share in (0, 0.25, 0.5, 1):
        protocol(share=share)
        sets[share] = drawn()
    assert [len(sets[share]) for share in (0, 1)] == [0, 80]
    assert sets[0.25] < sets[0.5] < sets[1]
    assert 8 <= len(sets[0.25]) <= 34  # 20, give or take nearly four standard deviations
    protocol(share=0.25, seed=8)
    assert drawn() != sets[0.25]
    with state.database.read() as session:
        study = session.scalars(sa.select(Study)).one()
    protocol(share=0, strata=[{"food_group": "no such group", "share": 1}, {"min_doubt": 1, "share": 1}])
    assert drawn() == set()
    protocol(share=0.5, strata=[{"min_doubt": 0.0001, "share": 1}])
    assert drawn() == sets[1]
    assert study.code == "pilot"


@pytest.fixture
def known_item(client, admin, state):
    """Send an item with a known answer."""

    def known_item(food="apple", mass_g=100.0, seed=0):
        client_id = uuid.uuid4()
        body = {
            "food": food,
            "mass_g": mass_g,
            "shown_g": 1.2 * mass_g,
            "polygon": [[10, 10], [50, 10], [50, 40]],
            "picture": base64.b64encode(pair(seed)["left"]).decode(),
        }
        answer = client.put(f"{STUDY}/known-items/{client_id}", headers=admin, json=body)
        assert answer.status_code == 204, answer.text
        return str(known_item_id(study_of(state), client_id))

    return known_item


@pytest.fixture
def draws(monkeypatch):
    """Say of which of a reviewer's decisions, counted from 0, the item is a known one."""

    def draws(*numbers):
        monkeypatch.setattr(BlindReview, "draw", lambda _, number: 0.0 if number in numbers else 1.0)

    return draws


def test_known_items_look_like_others_find_the_bad_reviewer_and_are_in_no_sum(
    phone, state, client, admin, reviewers, protocol, known_item, draws, sign_in_browser
):
    ann, bob, _ = reviewers
    truth = {known_item(mass_g=100.0 + seed, seed=seed): 100.0 + seed for seed in range(8)}
    for seed in range(6):
        eaten(phone, state, seed=seed)
    protocol(known_share=0.5)
    draws(1, 2, 4, 5, 7)
    sums = [client.get(call, headers=admin).content for call in ("/v1/records?study=pilot", f"{STUDY}/overview")]
    decided = {ann: [], bob: []}
    for browser, error in ((ann, 1.02), (bob, 1.6)):
        while (item := shown(browser)) is not None:
            grams = truth.get(item, 100.0) * error
            decide(browser, item, food="pear" if browser is bob else "apple", mass_g=f"{grams:.6f}")
            decided[browser].append(item)
    for items in decided.values():
        assert [item in truth for item in items] == [False, True, True, False, True, True, False, True] + 3 * [False]
    with state.database.read() as session:
        of_ann, of_bob = known_agreement(session, study_of(state).id)
    assert (of_ann.reviewer, of_ann.same, of_bob.reviewer, of_bob.same) == ("ann", of_ann.items, "bob", 0)
    assert of_ann.grams.upper.value < 10
    assert of_bob.grams.bias.value > 40
    assert "ann" in sign_in_browser("olga", pilot="owner").page(AGREEMENT).rpartition("known answer")[2]
    assert "known answer" not in text_of(ann.page(AGREEMENT))
    again = [client.get(call, headers=admin).content for call in ("/v1/records?study=pilot", f"{STUDY}/overview")]
    assert again == sums
    listed = client.get(f"{STUDY}/decisions", headers=admin).json()["items"]
    assert not {row["item"] for row in listed} & truth.keys()


def test_card_of_a_known_item_has_the_same_form_and_picture(phone, state, reviewers, protocol, known_item, draws):
    ann, *_ = reviewers
    eaten(phone, state, seed=1)
    item, known = shown(ann), known_item(seed=2)
    ordinary, picture = ann.page(BLIND), ann.get(f"{BLIND}/{item}/picture")
    decide(ann, item)
    protocol(known_share=0.5)
    draws(1)
    card, other = ann.page(BLIND), ann.get(f"{BLIND}/{known}/picture")
    assert shown(ann) == known
    assert shape_of(card) == shape_of(ordinary)
    assert (other.headers.keys(), other.content[:24]) == (picture.headers.keys(), picture.content[:24])
    assert uuid.UUID(known).version == uuid.UUID(item).version  # nor does its id tell
    assert shown(ann, skip=known) is None


def shape_of(page):
    """The elements of the card, but its foods."""
    card = page[page.index("<article") : page.index("</article>")]
    return re.findall(r"<(\w+)", re.sub(r'<span class="check">.*?</span>', "", card, flags=re.DOTALL))


@pytest.mark.both_stores
def test_reviewers_who_decide_at_once_settle_an_item_once(phone, state, client, admin, reviewers):
    """Each sees the other's decision or waits for it: none is lost, and the result is written by one of them."""
    meals = [Speaker(client, admin, eaten(phone, state, seed=seed)) for seed in range(5)]
    with state.database.read() as session:
        staff = dict(session.execute(sa.select(Staff.name, Staff.id)).all())
    study = study_of(state)
    callers = [StaffCaller(staff[name], name, False, uuid.uuid4(), {study.id: "reviewer"}) for name in ("ann", "bob")]
    for meal in meals:
        body = DecisionIn(item=meal.items()[0]["id"], food="apple", mass_g=100)
        at_once(*(partial(BlindReview(state, caller, study).decide, body) for caller in callers))
        assert [event["kind"] for event in meal.history()["items"]] == ["set_food", "set_mass"]
        assert meal.items()[0]["reviewed"]


def test_refused_form_keeps_what_was_entered(phone, state, reviewers):
    ann, *_ = reviewers
    eaten(phone, state)
    answer = ann.post(BLIND, item=shown(ann), choice="apple", mass_g="80 or so", q="", food="")
    assert answer.status_code == 422
    assert re.search(r'value="apple" data-key="1" checked', answer.text)
    assert 'value="80 or so"' in answer.text
    assert ann.post(BLIND, item="none", mass_g="").status_code == 422


def test_known_items_come_as_often_as_the_protocol_says(state, reviewers):
    """Of 2,000 numbers of a reviewer; which ones they are, only the server can tell."""
    study = study_of(state)
    review = BlindReview(state, StaffCaller(uuid.uuid4(), "ann", False, uuid.uuid4()), study)
    numbers = [review.draw(number) for number in range(2000)]
    assert 0.035 < sum(number < 0.05 for number in numbers) / 2000 < 0.065  # 3 standard deviations
    assert review.draw(7) == numbers[7]


def test_settings_show_the_protocol_and_keep_it(client, admin, reviewers, sign_in_browser):
    page = sign_in_browser("olga", pilot="owner")
    path = "/dashboard/studies/pilot/settings"
    assert "100 % of items; limit 20" in text_of(page.page(path))
    version = client.get(STUDY, headers=admin).json()["version"]
    answer = page.post(path, version=version, name="Pilot", day_starts="00:00", after_window_minutes="240", locale="de")
    assert answer.status_code == 303
    study = client.get(STUDY, headers=admin).json()
    assert study["locale"] == "de"
    assert study["double_review"] == ALL | {"strata": [], "known_share": 0}


def test_only_owners_send_known_items(client, admin, reviewers):
    headers = make_staff(client, admin, "eve", pilot="reviewer").headers
    assert client.put(f"{STUDY}/known-items/{uuid.uuid4()}", headers=headers, json={}).status_code == 403


def test_erased_meal_takes_its_decisions_with_it(phone, state, client, admin, reviewers):
    ann, *_ = reviewers
    meal = eaten(phone, state)
    decide(ann)
    assert client.delete(f"/v1/meals/{meal}", headers=phone.headers).status_code == 200
    with state.database.read() as session:
        assert session.scalars(sa.select(ReviewDecision)).all() == []


def test_agreement_page_has_the_figures_of_the_made_study(phone, state, reviewers, sign_in_browser):
    """60 people, 14 days: those that tests/unit/records/test_reviewers_agreement.py has of pingouin."""
    ann, *_ = reviewers
    eaten(phone, state)
    with state.database.write() as session:
        ids = dict(session.execute(sa.select(Staff.name, Staff.id)).all())
        (meal,) = session.scalars(sa.select(Meal))
        session.add_all(
            ReviewDecision(
                id=uuid.uuid4(),
                study_id=meal.study_id,
                meal_id=meal.id,
                item_id=uuid.UUID(int=number),
                staff_id=ids[name],
                is_final=False,
                food_key=food,
                mass_g=grams,
                energy_kcal=2 * grams,
                decided_at=meal.received_at,
            )
            for number, dish in enumerate(made_study())
            for name, (food, grams) in zip(("ann", "bob"), dish, strict=True)
        )
    page = ann.page(AGREEMENT)
    shown_figures = figures_of(page[: page.index("<figure")])
    bias = (13.602529312222837, 10.634187668982587, 16.570870955463086)
    same = sum(a[0] == b[0] for a, b in made_study())
    of_pair = [840, same, 0.8050287118432679, 0.776759918406456, 0.8332975052800797]
    of_pair += [0.9000186804914027, 0.8699765396815822, 0.9214501112824962, *bias]
    rows = [shown_figures[place : place + 29] for place in range(0, 87, 29)]
    assert rows[0][:11] == rows[2][:11] == pytest.approx(of_pair, rel=1e-9)
    assert rows[2][20:23] == pytest.approx([2 * each for each in bias], rel=1e-9)
    assert rows[1][8] == pytest.approx(-bias[0], rel=1e-9)
    assert page.count("bland-altman") == 2
    assert ann.page(AGREEMENT, format="csv").count("\n") == 1 + 2 * 840
