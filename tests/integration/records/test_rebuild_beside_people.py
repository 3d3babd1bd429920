"""What a person says while records are built or computed again is not overwritten by what was read before it."""

import threading

import pytest
import sqlalchemy as sa

from app.meals.stored.identification_models import IndexEntry
from app.meals.stored.meal_parts import parts_of
from app.meals.stored.record_models import EffectiveRecord, ItemFood
from app.records.recompute_records import rebuild_records, recompute_nutrients
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import identified_item
from tests.support.photographs import pair

HEAD_START_SECONDS = 0.5  # of the person: they wait for it where the meal is locked, and are through where it is not


def rebuild(state):
    rebuild_records(state.database, write=True)


def recompute(state):
    with state.database.write() as session:  # its figures are others now, so that a new row is to be written
        session.execute(sa.update(ItemFood).values(density_g_per_ml=2.0 * ItemFood.density_g_per_ml))
    recompute_nutrients(state.database, write=True, author="test", reason="test", tell=lambda _: None)


@pytest.mark.both_stores
@pytest.mark.parametrize("build", [rebuild, recompute])
def test_confirmation_during_a_rebuild_stays_in_record_and_index(phone, state, client, monkeypatch, build):
    body = meal_metadata()
    assert phone.post(pair(), body).status_code == 202
    estimates.save(state, body["id"], identified_item({"apple": 0.9}))
    person = Speaker(client, phone.headers, body["id"])
    item_id = person.items()[0]["id"]
    words = []

    def read_slowly(session, batch):
        parts = parts_of(session, batch)
        if batch:
            words.append(threading.Thread(target=person.say, args=("confirm",), kwargs={"item": item_id}))
            words[-1].start()
            words[-1].join(HEAD_START_SECONDS)
        return parts

    with monkeypatch.context() as patch:
        patch.setattr("app.records.recompute_records.parts_of", read_slowly)
        build(state)
    (word,) = words
    word.join()
    with state.database.read() as session:
        assert session.scalars(sa.select(EffectiveRecord.status)).all() == ["confirmed"]
        assert session.scalars(sa.select(IndexEntry.food_key)).all() == ["apple"]
    assert rebuild_records(state.database, write=False).different == 0
