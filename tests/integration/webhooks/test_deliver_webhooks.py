"""The chore that sends, over a real receiver on 127.0.0.1 and both kinds of database."""

import base64
import contextlib
import hashlib
import hmac
import json
import pathlib
import random
import re
import threading
import uuid
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.db.session import Database
from app.outbox.models import Webhook, WebhookDelivery
from app.outbox.write import announce
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, Study
from app.people.privacy_models import AuditEvent
from app.privacy.erase import announce_withdrawal
from app.webhooks import deliver_webhooks
from app.webhooks import queries as sql
from app.webhooks.deliver_webhooks import MAX_ATTEMPTS, PAUSES, DeliverWebhooks
from app.webhooks.queries import Due
from app.webhooks.webhook_post import WebhookPost
from app.webhooks.webhook_signature import SigningSecrets, new_secret, open_secrets, seal_secrets
from tests.support.receivers import receiver
from tests.support.waiting import PATIENCE_SECONDS

KEY = "a key for tests only, of no worth"


class Clock:
    def __init__(self):
        self.now = datetime.now(UTC)

    def __call__(self):
        return self.now

    def catch_up(self):
        """What is announced is due by the real clock."""
        self.now = max(self.now, datetime.now(UTC))


class Sending:
    """A study with webhooks, and a worker's chore over them."""

    def __init__(self, database):
        self.database = database
        self.box = SecretBox(KEY)
        self.clock = Clock()
        self.secrets = {}
        with database.write() as session:
            self.study = Study(id=uuid.uuid4(), code="pilot", name="Pilot", change_seq=0, created_at=self.clock())
            session.add(self.study)
        self.chore = self.new_chore()

    def new_chore(self, box=None, **options):
        post = WebhookPost(allow_loopback=True, **options)
        return DeliverWebhooks(self.database, box or self.box, post, now=self.clock, chance=random.Random(1))

    def hook(self, url, *events, study=None):
        secret, row = new_secret(), uuid.uuid4()
        with self.database.write() as session:
            session.add(
                Webhook(
                    id=row,
                    study_id=(study or self.study).id,
                    url=url,
                    events=list(events or ("*",)),
                    secret_sealed=seal_secrets(self.box, SigningSecrets(secret)),
                    author="owner",
                    created_at=self.clock(),
                )
            )
        self.secrets[row] = secret
        return row

    def announce(self, event="day.closed", **data):
        with self.database.write() as session:
            announce(session, self.study.id, event, data)
        self.clock.catch_up()

    def deliver(self, chore=None):
        """One turn of the chore, to its end; failures' rests are slept over."""
        chore = chore or self.chore
        chore._rests.clear()
        started = chore.run()
        assert chore.wait_until_idle(PATIENCE_SECONDS)
        return started

    def deliver_all(self):
        while self.deliver():
            pass

    def wait(self, pause):
        self.clock.now += pause

    def rows(self, hook=None):
        with self.database.read() as session:
            query = sa.select(WebhookDelivery).order_by(WebhookDelivery.created_at, WebhookDelivery.id)
            return [row for row in session.scalars(query) if hook in (None, row.webhook_id)]

    def webhook(self, hook):
        with self.database.read() as session:
            return session.get_one(Webhook, hook)


@pytest.fixture
def sending(prepared_database_url):
    database = Database(prepared_database_url)
    yield Sending(database)
    database.dispose()


def signatures_fit(got, secret):
    """The standard's scheme, written down a second time."""
    headers = {name.lower(): value for name, value in got.headers.items()}
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + got.body
    key = base64.b64decode(secret.split("_", 1)[1])
    wanted = "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    return [signature == wanted for signature in headers["webhook-signature"].split(" ")]


def test_event_is_delivered_once_signed_with_its_payload_of_the_time_and_without_its_secret_in_the_database(sending):
    with receiver() as there:
        hook = sending.hook(there.url)
        sending.announce("day.closed", participant="P001", local_date="2026-11-20")
        assert sending.deliver() == 1
        assert sending.deliver() == 0
    (got,) = there.received
    (row,) = sending.rows()
    assert (row.state, row.attempts, row.last_status, row.last_error, row.next_try_at) == (
        "delivered", 1, 204, None, None,
    )  # fmt: skip
    assert row.delivered_at == sending.clock()
    assert got.headers["Webhook-Id"] == str(row.id)
    assert got.headers["Content-Type"] == "application/json"
    assert signatures_fit(got, sending.secrets[hook]) == [True]
    body = json.loads(got.body)
    assert body == row.payload
    assert body["type"] == "day.closed"
    assert body["data"] == {"study": "pilot", "participant": "P001", "local_date": "2026-11-20"}
    assert datetime.fromisoformat(body["timestamp"]).tzinfo is not None
    assert_snippet_of_the_documents_verifies(got, sending.secrets[hook], sending.clock())
    assert_is_in_no_dump(sending.database, sending.secrets[hook])


def assert_snippet_of_the_documents_verifies(got, secret, now):
    text = (pathlib.Path(__file__).parents[3] / "docs" / "webhooks.md").read_text()
    names = {}
    exec(re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1), names)
    verify = names["verify"]
    assert verify(got.body, got.headers, secret)["data"]["participant"] == "P001"
    with pytest.raises(ValueError, match="signature"):
        verify(got.body + b" ", got.headers, secret)
    with pytest.raises(ValueError, match="signature"):
        verify(got.body, got.headers, new_secret())
    old = {**got.headers, "Webhook-Timestamp": str(int(now.timestamp()) - 3600)}
    with pytest.raises(ValueError, match="old"):
        verify(got.body, old, secret)


def assert_is_in_no_dump(database, secret):
    encoded = secret.split("_")[1]
    raw = base64.b64decode(encoded)
    with database.read() as session:
        tables = (Webhook.__table__, WebhookDelivery.__table__, AuditEvent.__table__)
        dump = [repr(tuple(row)) for table in tables for row in session.execute(sa.select(table))]
    assert len(dump) >= 2
    assert encoded not in "\n".join(dump)
    assert raw.hex() not in "\n".join(dump)
    if database.is_sqlite:
        path = pathlib.Path(sa.make_url(database.url).database)
        held = b"".join(file.read_bytes() for file in path.parent.glob(path.name + "*"))
        assert encoded.encode() not in held
        assert raw not in held


def test_only_subscribed_webhooks_of_the_study_get_an_event_and_none_that_of_a_failed_transaction(sending):
    with sending.database.write() as session:
        other = Study(id=uuid.uuid4(), code="other", name="Other", change_seq=0, created_at=sending.clock())
        session.add(other)
    wanted = {sending.hook("https://a.example.org/", "day.closed"), sending.hook("https://b.example.org/")}
    sending.hook("https://c.example.org/", "meal.failed")
    sending.hook("https://d.example.org/", study=other)
    disabled = sending.hook("https://e.example.org/")
    with sending.database.write() as session:
        session.get_one(Webhook, disabled).disabled_at = sending.clock()
    with contextlib.suppress(RuntimeError), sending.database.write() as session:
        announce(session, sending.study.id, "day.closed", {})
        session.flush()
        raise RuntimeError
    assert sending.rows() == []
    sending.announce("day.closed")
    assert {row.webhook_id for row in sending.rows()} == wanted
    assert len({row.payload["id"] for row in sending.rows()}) == 1  # one event


def test_failed_delivery_is_retried_with_the_same_id_and_body_until_accepted(sending):
    with receiver(answer=lambda number: 500 if number <= 2 else 200) as there:
        hook = sending.hook(there.url)
        sending.announce("day.closed", participant="P001")
        for pause in PAUSES[:2]:
            assert sending.deliver() == 1
            (row,) = sending.rows()
            assert (row.state, row.last_status, row.last_error) == ("waiting", 500, "The receiver answered 500.")
            assert 0.9 * pause <= row.next_try_at - sending.clock() <= 1.1 * pause
            assert sending.deliver() == 0  # not yet
            sending.wait(1.1 * pause)
        assert sending.deliver() == 1
    assert [row.state for row in sending.rows()] == ["delivered"]
    assert len({(got.headers["Webhook-Id"], got.body) for got in there.received}) == 1
    assert len({got.headers["Webhook-Timestamp"] for got in there.received}) == 3
    assert all(signatures_fit(got, sending.secrets[hook]) == [True] for got in there.received)


def test_delivery_is_given_up_after_three_days(sending):
    begin = sending.clock()
    with receiver(answer=503) as there:
        sending.hook(there.url)
        sending.announce()
        for attempt in range(MAX_ATTEMPTS):
            assert sending.deliver() == 1, attempt
            sending.clock.now = sending.rows()[0].next_try_at or sending.clock()
        sending.wait(timedelta(days=30))
        assert sending.deliver() == 0
    (row,) = sending.rows()
    assert (row.state, row.attempts, row.next_try_at) == ("given_up", MAX_ATTEMPTS, None)
    assert len(there.received) == MAX_ATTEMPTS == 10
    assert timedelta(days=2.8) < sending.clock() - timedelta(days=30) - begin < timedelta(days=3.5)


def test_receiver_may_ask_for_a_longer_pause_but_for_no_more_than_a_day(sending):
    for asked, wanted in (("3600", timedelta(hours=1)), ("999999999", timedelta(days=1)), ("1", None)):
        with receiver(answer=503, headers={"Retry-After": asked}) as there:
            hook = sending.hook(there.url, f"only.{asked}")
            sending.announce(f"only.{asked}")
            sending.deliver()
        (row,) = sending.rows(hook)
        pause = row.next_try_at - sending.clock()
        assert pause == wanted if wanted else pause < timedelta(seconds=6)


def test_answer_410_disables_the_webhook_and_is_noted(sending):
    with receiver(answer=410) as there:
        hook = sending.hook(there.url)
        sending.announce()
        sending.announce()
        sending.deliver()
        assert sending.deliver() == 0
    sending.chore.give_up_unsendable()
    assert sending.webhook(hook).disabled_at == sending.clock()
    assert [row.state for row in sending.rows()] == ["given_up", "given_up"]
    assert len(there.received) == 1
    with sending.database.read() as session:
        event = session.scalars(sa.select(AuditEvent)).one()
    assert (event.actor_kind, event.action, event.subject) == ("system", "webhook.disable", str(hook))
    assert event.details == {"reason": "gone"}


def test_webhook_that_gave_up_five_in_a_row_is_disabled(sending, monkeypatch):
    monkeypatch.setattr(deliver_webhooks, "MAX_ATTEMPTS", 1)
    with receiver(answer=lambda number: 200 if number == 3 else 500) as there:
        hook = sending.hook(there.url)
        for number in range(1, 9):
            assert sending.webhook(hook).disabled_at is None, number
            sending.announce()
            sending.deliver()
            sending.wait(timedelta(seconds=1))
    states = [row.state for row in sending.rows()]
    assert states == ["given_up", "given_up", "delivered", *["given_up"] * 5]
    assert sending.webhook(hook).disabled_at is not None
    with sending.database.read() as session:
        assert session.scalars(sa.select(AuditEvent)).one().details == {"reason": "given_up_in_a_row"}


@pytest.mark.both_stores
def test_two_workers_do_not_send_the_same_delivery_at_once(sending):
    with receiver() as there:
        for _ in range(6):
            sending.hook(there.url)
        sending.announce()
        chores = [sending.new_chore() for _ in range(3)]
        starts = [threading.Thread(target=chore.run) for chore in chores]
        for start in starts:
            start.start()
        for start in starts:
            start.join()
        assert all(chore.wait_until_idle(PATIENCE_SECONDS) for chore in chores)
    assert len(there.received) == 6
    assert {row.attempts for row in sending.rows()} == {1}


@pytest.mark.both_stores
def test_delivery_of_a_worker_that_died_is_sent_again_once_its_claim_has_run_out_or_given_up_after_the_last(sending):
    def die_with_a_claim(attempts):
        with sending.database.write() as session:
            row, _ = sql.claim_due(session, Due(sending.clock()), until=sending.clock() + deliver_webhooks.CLAIM)
            row.attempts = attempts

    with receiver() as there:
        sending.hook(there.url, "day.closed")
        sending.announce()
        die_with_a_claim(1)
        assert sending.deliver() == 0
        sending.wait(deliver_webhooks.CLAIM)
        assert sending.deliver() == 1
    assert len(there.received) == 1
    assert sending.rows()[0].state == "delivered"
    last = sending.hook("https://a.example.org/", "meal.failed")
    sending.announce("meal.failed")
    die_with_a_claim(MAX_ATTEMPTS)
    sending.chore.give_up_unsendable()
    assert sending.rows(last)[0].state == "waiting"  # it may be under way
    sending.wait(deliver_webhooks.CLAIM)
    sending.chore.give_up_unsendable()
    assert sending.rows(last)[0].state == "given_up"


def test_slow_receiver_holds_up_neither_others_nor_the_chore(sending):
    with receiver() as slow, receiver() as quick:
        slow.may_answer.clear()
        held = sending.hook(slow.url)
        sending.announce()
        sending.announce()
        assert sending.chore.run() == 1  # one a webhook at a time
        sending.hook(quick.url)
        sending.announce()
        assert sending.chore.run() == 1
        with sending.chore._lock:
            assert sending.chore._lock.wait_for(lambda: sending.chore._busy == {held}, PATIENCE_SECONDS)
        assert len(quick.received) == 1
        assert len(slow.received) == 1
        slow.may_answer.set()
        assert sending.chore.wait_until_idle(PATIENCE_SECONDS)
        sending.deliver_all()
    assert {row.state for row in sending.rows()} == {"delivered"}


def test_waiting_deliveries_of_a_webhook_are_sent_in_one_turn_which_ends_in_favour_of_others(sending, monkeypatch):
    with receiver() as there:
        sending.hook(there.url)
        for number in range(20):
            sending.announce("day.closed", number=number)
        assert sending.deliver() == 1
        assert [json.loads(got.body)["data"]["number"] for got in there.received] == list(range(20))
        assert {row.state for row in sending.rows()} == {"delivered"}
        monkeypatch.setattr(deliver_webhooks, "TURN_SECONDS", 0.0)
        sending.announce()
        sending.announce()
        assert sending.deliver() == 1
    assert len(there.received) == 21


def test_failing_webhook_rests_with_all_its_deliveries(sending):
    with receiver(answer=500) as failing:
        hook = sending.hook(failing.url)
        for _ in range(3):
            sending.announce()
        assert sending.chore.run() == 1
        assert sending.chore.wait_until_idle(PATIENCE_SECONDS)
        assert sending.chore.run() == 0
        assert set(sending.chore._rests) == {hook}
    assert len(failing.received) == 1


def test_no_more_than_a_few_are_under_way_at_once(sending):
    with receiver() as slow:
        slow.may_answer.clear()
        for _ in range(deliver_webhooks.MAX_CONCURRENT + 3):
            sending.hook(slow.url)
        sending.announce()
        assert sending.chore.run() == deliver_webhooks.MAX_CONCURRENT
        assert sending.chore.run() == 0
        slow.may_answer.set()
        assert sending.chore.wait_until_idle(PATIENCE_SECONDS)
        assert sending.deliver() == 3


def test_unreadable_secret_is_reported_and_works_again_with_its_key(sending):
    """A database restored beside another secret key: nothing is sent unsigned, nothing crashes, nothing is lost."""
    with receiver() as there:
        sending.hook(there.url)
        sending.announce()
        stranger = sending.new_chore(box=SecretBox("another key, of a server that was set up anew"))
        assert sending.deliver(stranger) == 1
        (row,) = sending.rows()
        assert (row.state, row.attempts, row.last_status) == ("waiting", 1, None)
        assert "TADA_SECRET_KEY" in row.last_error
        assert sending.deliver(stranger) == 0  # it waits as after any failure
        assert there.received == []
        sending.wait(2 * PAUSES[0])
        assert sending.deliver() == 1
    assert [row.state for row in sending.rows()] == ["delivered"]


@pytest.mark.both_stores
def test_old_secret_signs_along_for_a_day_after_a_rotation(sending):
    with receiver() as there:
        hook = sending.hook(there.url)
        old = sending.secrets[hook]
        with sending.database.write() as session:
            row = session.get_one(Webhook, hook)
            known = open_secrets(sending.box, row.secret_sealed).rotated(sending.clock())
            row.secret_sealed = seal_secrets(sending.box, known)
            assert len(row.secret_sealed) <= 300  # the column's room
        sending.announce()
        sending.deliver()
        sending.wait(timedelta(days=1, seconds=1))
        sending.announce()
        sending.deliver()
    first, second = there.received
    assert signatures_fit(first, known.current) == [True, False]
    assert signatures_fit(first, old) == [False, True]
    assert signatures_fit(second, known.current) == [True]


def test_delivery_erased_while_it_is_sent_stays_erased(sending):
    with receiver() as there:
        there.may_answer.clear()
        sending.hook(there.url)
        sending.announce()
        assert sending.chore.run() == 1
        with sending.database.write() as session:
            session.execute(sa.delete(WebhookDelivery))
        there.may_answer.set()
        assert sending.chore.wait_until_idle(PATIENCE_SECONDS)
    assert sending.rows() == []


def test_deliveries_that_ended_are_removed_after_thirty_days(sending):
    with receiver() as there:
        sending.hook(there.url)
        sending.announce()
        sending.deliver()
        sending.hook("https://b.example.org/", "meal.failed")
        sending.announce("meal.failed")
        sending.deliver_all()
        sending.wait(timedelta(days=29))
        sending.chore.remove_old()
        assert len(sending.rows()) == 3
        sending.wait(timedelta(days=2))
        sending.chore.remove_old()
    assert [row.state for row in sending.rows()] == ["waiting"]


def test_notice_of_a_withdrawal_names_the_participant_until_it_is_delivered_only(sending):
    with sending.database.write() as session:
        participant = Participant(
            id=uuid.uuid4(), study_id=sending.study.id, code="P-SECRET-7", created_at=sending.clock()
        )
        session.add(participant)
    with receiver() as there:
        sending.hook(there.url)
        with sending.database.write() as session:
            announce_withdrawal(session, participant, "erase")
            session.execute(sa.delete(Participant))  # the notice does not hold the row back
        sending.clock.catch_up()
        sending.deliver()
    assert json.loads(there.received[0].body)["data"] == {
        "study": "pilot",
        "participant": "P-SECRET-7",
        "policy": "erase",
    }
    (row,) = sending.rows()
    assert row.state == "delivered"
    assert "P-SECRET-7" not in json.dumps(row.payload)
