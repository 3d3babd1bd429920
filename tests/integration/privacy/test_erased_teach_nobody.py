"""Whose food is erased teaches nobody any more: not their study, not those that it was shared with."""

import uuid

import pytest
import sqlalchemy as sa

from app.candidates.identify import IdentifyFoods
from app.identification.food_index import shipped_index
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.people.models import Study
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import answer, found_item, vcm
from tests.support.looks import vectors_of
from tests.support.photographs import pair


@pytest.fixture
def looks():
    """A real vector, of a banana, which the tests say to be something that the index does not know."""
    return vectors_of(shipped_index(), "banana")[0]


@pytest.fixture
def meal_of(state, client):
    def meal_of(phone, looks):
        body = meal_metadata()
        assert phone.post(pair(), body).status_code == 202
        estimates.save(state, body["id"], found_item(hint=None, vcm=vcm(*looks)))
        return Speaker(client, phone.headers, body["id"])

    return meal_of


@pytest.fixture
def learned_by(state, looks):
    """What a meal of a study learns from: learned_by(speaker) -> (its index's version, the candidates' keys)."""
    identify = IdentifyFoods(state.database)

    def learned_by(speaker):
        with state.database.read() as session:
            meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(speaker.meal_id))).one()
        told = RunAnswer.model_validate(answer(found_item(hint=None, vcm=vcm(*looks))))
        identify.add_candidates(meal, told)
        (item,) = told.items
        return item.index_version, [one.food for one in item.candidates]

    return learned_by


def test_erased_food_is_unlearned_in_its_study_and_in_studies_it_was_shared_with(
    state, enrol, client, looks, meal_of, learned_by
):
    leaving, staying = enrol("leaving", "sharing"), enrol("staying", "sharing")
    elsewhere = enrol("elsewhere", "other")
    with state.database.write() as session:
        session.execute(sa.update(Study).where(Study.code == "sharing").values(shares_index=True))
    askers = [meal_of(staying, looks), meal_of(elsewhere, looks)]
    before = [learned_by(asker) for asker in askers]
    for method, path in (("DELETE", "/v1/meals/{}"), ("POST", "/v1/me/withdrawal")):
        taught = meal_of(leaving, looks)
        taught.say("set_food", item=taught.items()[0]["id"], food="pineapple")
        for asker, (version, _) in zip(askers, before, strict=True):
            learned, keys = learned_by(asker)
            assert learned.startswith(f"{version} + 1 confirmed ")
            assert "pineapple" in keys
        assert client.request(method, path.format(taught.meal_id), headers=leaving.headers).status_code == 200
        assert [learned_by(asker) for asker in askers] == before


def test_study_that_stops_sharing_is_unlearned_by_others(state, enrol, looks, meal_of, learned_by, client, admin):
    phone, asker = enrol("P1", "sharing"), meal_of(enrol("P2", "other"), looks)
    before = learned_by(asker)
    taught = meal_of(phone, looks)
    taught.say("set_food", item=taught.items()[0]["id"], food="pineapple")
    assert learned_by(asker) == before
    for number, (shares, expected) in enumerate(((True, True), (False, False)), 1):
        headers = admin | {"If-Match": f'"{number}"'}
        changed = client.patch("/v1/studies/sharing", headers=headers, json={"shares_index": shares})
        assert changed.status_code == 200, changed.text
        assert ("pineapple" in learned_by(asker)[1]) is expected
