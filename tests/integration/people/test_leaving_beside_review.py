"""A reviewer confirms while the participant leaves: neither is ended for the other's sake (PostgreSQL's deadlocks)."""

import threading

import pytest
import sqlalchemy as sa

from app.people import privacy_queries as people_privacy
from app.people.models import Participant
from app.privacy import queries as privacy
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker, new_event
from tests.support import estimates
from tests.support.estimates import identified_item
from tests.support.photographs import pair
from tests.support.waiting import wait_for_blocked_transaction


@pytest.mark.both_stores
def test_reviewers_confirmation_waits_for_a_withdrawal_under_way(phone, state, client, admin):
    body = meal_metadata()
    assert phone.post(pair(), body).status_code == 202
    estimates.save(state, body["id"], identified_item({"apple": 0.9}))
    reviewer = Speaker(client, admin, body["id"])
    item_id, answers = reviewer.items()[0]["id"], []

    def confirm():
        answers.append(reviewer.send(new_event("confirm", item=item_id), if_match="*"))

    with state.database.write() as session:  # as privacy/withdraw.py locks: the person, then their meals
        participant_id = session.scalars(sa.select(Participant.id)).one()
        people_privacy.lock_participant(session, participant_id)
        word = threading.Thread(target=confirm)
        word.start()
        wait_for_blocked_transaction(state.database)  # the reviewer waits for the one who leaves
        assert len(privacy.lock_meals_of(session, participant_id)) == 1
    word.join()
    assert [answer.status_code for answer in answers] == [201], answers[0].text
