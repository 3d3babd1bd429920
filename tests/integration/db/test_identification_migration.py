"""The migration of identification: a process of the version before beside it, and back and forth with data in it."""

import pytest
import sqlalchemy as sa

from app.db.migrate import downgrade, upgrade
from app.db.models import IndexEntry, Item, ItemIdentification
from app.db.queries.privacy import _delete_in_order as delete_in_order
from app.db.schema_state import is_current
from app.services.rebuild_records import rebuild_records
from tests import estimates
from tests.estimates import identified_item
from tests.integration.conftest import meal_metadata
from tests.integration.reviewing import Speaker
from tests.photographs import pair

BEFORE = "20261121_people_review"
NEW_TABLES = frozenset({IndexEntry, ItemIdentification})


@pytest.fixture
def meal(phone, state, client):
    """A confirmed meal that the index knows: one item with a hint, one without."""
    body = meal_metadata(hints=[{"point": [20, 20], "food": "apple"}])
    assert phone.post(pair(), body).status_code == 202
    estimates.save(state, body["id"], identified_item({"pear": 0.9}, hint=0), identified_item({"banana": 0.9}))
    meal = Speaker(client, phone.headers, body["id"])
    meal.say("confirm_meal")
    return meal


def count(state, table):
    with state.database.read() as session:
        return session.scalar(sa.select(sa.func.count()).select_from(table))


def test_process_that_does_not_know_the_new_tables_erases_a_meal(meal, state, monkeypatch):
    def of_the_version_before(session, *steps):
        return delete_in_order(session, *(step for step in steps if step[0] not in NEW_TABLES))

    assert (count(state, ItemIdentification), count(state, IndexEntry)) == (2, 2)
    monkeypatch.setattr("app.db.queries.privacy._delete_in_order", of_the_version_before)
    answer = meal.client.delete(f"/v1/meals/{meal.meal_id}", headers=meal.headers)
    assert answer.status_code == 200, answer.text
    assert (count(state, Item), count(state, ItemIdentification), count(state, IndexEntry)) == (0, 0, 0)


def test_downgrade_leaves_what_people_said_and_upgrade_takes_it_up_again(meal, state):
    before = [(item["food"]["key"], item["status"], item["consumed_g"]) for item in meal.items()]
    downgrade(state.database, BEFORE)
    with state.database.read() as session:
        sources = session.scalars(sa.text("SELECT source FROM item_candidate")).all()
    assert sources == ["hint"]
    upgrade(state.database)
    assert is_current(state.database)
    assert [(item["food"]["key"], item["status"], item["consumed_g"]) for item in meal.items()] == before
    assert [one["source"] for item in meal.items() for one in item["candidates"]] == ["hint"]
    assert rebuild_records(state.database, write=False).different == 0
