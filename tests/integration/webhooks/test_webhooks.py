"""Webhooks over HTTP, from making one to a delivery that a receiver verifies."""

import hashlib
import json
import re
import threading
import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.core.errors import Failure
from app.jobs import queries as jobs
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.queries import lock_meal
from app.operations.chores import worker_chores
from app.outbox.models import ALL_EVENTS, EVENTS, Webhook, WebhookDelivery
from app.people.access.secret_box import SecretBox
from app.people.models import Participant
from app.people.privacy_models import AuditEvent
from app.privacy.erase import announce_meal_deletion, announce_withdrawal
from app.webhooks import safe_address
from app.webhooks.deliver_webhooks import DeliverWebhooks
from app.webhooks.webhook_post import WebhookPost
from app.webhooks.webhook_signature import open_secrets
from tests.support.photographs import photograph
from tests.support.receivers import receiver
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction, wait_until

SECRET = re.compile(r"whsec_[A-Za-z0-9+/]{43}=")


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"webhook_allow_loopback": True})


@pytest.fixture
def names(monkeypatch):
    """Name -> addresses; others do not resolve, and an address is its own."""
    known = {"hooks.example.org": ["8.8.8.8"], "inside.example.org": ["8.8.8.8", "10.0.0.1"]}
    monkeypatch.setattr(
        safe_address, "system_resolver", lambda host, _: known.get(host, [host] if is_address(host) else [])
    )
    return known


@pytest.fixture
def owner(client, admin, names):
    """The API of a study's webhooks as its owner uses it."""
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "pilot", "marker": "plain:9x7:11"})

    class Owner:
        root = "/v1/studies/pilot/webhooks"

        def call(self, method, path="", body=None, tag="*"):
            headers = admin | ({"If-Match": tag} if method == "PATCH" and tag else {})
            return client.request(method, self.root + path, headers=headers, json=body)

        def make(self, url="https://hooks.example.org/a", *events):
            return self.call("POST", "", {"url": url, "events": list(events or ("*",))})

        def made(self, *arguments):
            answer = self.make(*arguments)
            assert answer.status_code == 201, answer.text
            return answer.json()["webhook"]["id"]

    return Owner()


def is_address(host):
    return host[0].isdigit() or ":" in host


def deliver(state):
    chore = DeliverWebhooks(state.database, state.part(SecretBox), WebhookPost(allow_loopback=True))
    started = chore.run()
    assert chore.wait_until_idle(PATIENCE_SECONDS)
    return started


def chores_of(state):
    """What a worker does, by name."""
    return {
        chore.name: chore for chore in worker_chores(state.database, state.blobs, state.part(SecretBox), state.settings)
    }


def audited(state):
    with state.database.read() as session:
        rows = session.scalars(sa.select(AuditEvent).where(AuditEvent.action.like("webhook.%")).order_by(AuditEvent.id))
        return [row.action for row in rows]


def test_new_webhook_shows_its_secret_once(owner, state):
    answer = owner.make("https://hooks.example.org/a?b=c", "meal.failed", "meal.failed", "day.closed")
    assert answer.status_code == 201
    body = answer.json()
    assert SECRET.fullmatch(body["secret"])
    assert body["previous_until"] is None
    assert body["webhook"]["events"] == ["day.closed", "meal.failed"]
    assert answer.headers["Cache-Control"] == "private, no-store"
    path = answer.headers["Location"].removeprefix(owner.root)
    for later in (owner.call("GET", path), owner.call("GET"), owner.call("GET", f"{path}/deliveries")):
        assert later.status_code == 200
        assert body["secret"] not in later.text
        assert "secret" not in later.text
    assert owner.call("GET").json()["items"] == [body["webhook"]] == [owner.call("GET", path).json()]
    assert audited(state) == ["webhook.create"]


def test_each_event_is_known_to_the_api():
    from app.webhooks.schemas import EventName

    assert set(EventName.__args__) == {ALL_EVENTS, *EVENTS}


def test_unsafe_address_is_refused_on_creation_and_change_and_so_is_a_bad_body(owner):
    """All that makes an address unsafe: tests/unit/webhooks/test_safe_address.py."""
    good = "https://hooks.example.org/a"
    path = f"/{owner.made(good)}"
    for url in (
        "http://hooks.example.org/",
        "https://10.0.0.1/",
        "https://inside.example.org/",
        "https://nowhere.example.org/",
    ):
        for answer in (owner.make(url), owner.call("PATCH", path, {"url": url})):
            assert (answer.status_code, answer.json()["code"]) == (422, "webhook_address_refused"), url
            assert "10.0.0.1" not in answer.json()["detail"]
    assert owner.call("GET", path).json()["url"] == good
    for body in (
        {"url": good},
        {"url": good, "events": []},
        {"url": good, "events": ["meal.eaten"]},
        {"url": good, "events": ["ping"]},
        {"url": good, "events": ["*"] * 21},
        {"url": good, "events": ["*"], "secret": "whsec_mine"},
        {"url": f"{good}\0", "events": ["*"]},
        {"url": good + "a" * 500, "events": ["*"]},
    ):
        answer = owner.call("POST", "", body)
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), body


def test_eleventh_webhook_is_refused_until_one_is_disabled(owner):
    made = [owner.made() for _ in range(10)]
    assert owner.make().json()["code"] == "webhooks_too_many"
    assert owner.call("DELETE", f"/{made[0]}").status_code == 204
    assert owner.make().status_code == 201
    assert owner.call("PATCH", f"/{made[0]}", {"is_enabled": True}).json()["code"] == "webhooks_too_many"


def test_change_keeps_what_is_left_out_is_noted_once_and_refused_for_an_older_version(owner, state):
    path = f"/{owner.made()}"
    assert owner.call("PATCH", path, {"events": ["meal.failed"]}).json()["events"] == ["meal.failed"]
    assert owner.call("PATCH", path, {"events": ["meal.failed"]}).status_code == 200
    disabled = owner.call("PATCH", path, {"is_enabled": False}).json()
    assert disabled["disabled_at"] is not None
    assert (disabled["url"], disabled["events"]) == ("https://hooks.example.org/a", ["meal.failed"])
    assert owner.call("PATCH", path, {"is_enabled": True}).json()["disabled_at"] is None
    assert owner.call("PATCH", path, {}).status_code == 422
    assert audited(state) == ["webhook.create", *["webhook.change"] * 3]
    read = owner.call("GET", path)
    assert owner.call("PATCH", path, {"is_enabled": False}, tag=None).status_code == 428
    changed = owner.call("PATCH", path, {"events": ["day.closed"]}, tag=read.headers["ETag"])
    assert (changed.status_code, changed.json()["version"]) == (200, read.json()["version"] + 1)
    late = owner.call("PATCH", path, {"is_enabled": False}, tag=read.headers["ETag"])
    assert (late.status_code, late.json()["code"]) == (412, "precondition_failed")
    assert late.json()["version"] == changed.json()["version"]
    assert owner.call("PATCH", path, {"is_enabled": False}, tag=changed.headers["ETag"]).status_code == 200


def test_disabled_webhook_gets_no_events_and_no_test(owner, state):
    path = f"/{owner.made()}"
    owner.call("POST", f"{path}/test")
    assert [owner.call("DELETE", path).status_code for _ in range(2)] == [204, 204]
    assert owner.call("POST", f"{path}/test").json()["code"] == "webhook_disabled"
    assert deliver(state) == 0
    chores_of(state)["give_up_deliveries"].run()
    (row,) = owner.call("GET", f"{path}/deliveries").json()["items"]
    assert (row["event"], row["state"]) == ("ping", "given_up")
    assert audited(state) == ["webhook.create", "webhook.test", "webhook.disable"]


def test_ping_is_delivered_by_a_worker_s_chore_logged_and_replayed_unchanged(owner, state):
    with receiver() as there:
        path = f"/{owner.made(there.url, 'meal.failed')}"
        ping = owner.call("POST", f"{path}/test")
        assert ping.status_code == 202
        chores_of(state)["deliver_webhooks"].run()
        (row,) = wait_until(
            lambda: owner.call("GET", f"{path}/deliveries?state=delivered").json()["items"], "its delivery"
        )
        assert (row["id"], row["state"], row["last_status"]) == (ping.json()["id"], "delivered", 204)
        again = owner.call("POST", f"{path}/deliveries/{row['id']}/replay")
        assert again.status_code == 202
        assert deliver(state) == 1
    first, second = there.received
    assert first.body == second.body
    assert json.loads(first.body)["type"] == "ping"
    assert (first.headers["Webhook-Id"], second.headers["Webhook-Id"]) == (row["id"], again.json()["id"])
    assert row["id"] != again.json()["id"]


def test_worker_that_may_not_call_the_loopback_does_not(owner, state):
    """The setting was taken back, or the URL came in by another way: each delivery is checked anew."""
    with receiver() as there:
        path = f"/{owner.made(there.url)}"
        owner.call("POST", f"{path}/test")
        chore = DeliverWebhooks(state.database, state.part(SecretBox), WebhookPost(allow_loopback=False))
        assert chore.run() == 1
        assert chore.wait_until_idle(PATIENCE_SECONDS)
        (row,) = owner.call("GET", f"{path}/deliveries").json()["items"]
    assert (row["state"], row["last_status"], row["attempts"]) == ("waiting", None, 1)
    assert row["last_error"] == "The URL must begin with https://."
    assert there.received == []


def test_rotated_secret_is_shown_once_and_the_old_one_signs_along_unless_the_key_does_not_open_it(owner, state):
    answer = owner.make().json()
    path = f"/{answer['webhook']['id']}"
    fresh = owner.call("POST", f"{path}/secret").json()
    assert SECRET.fullmatch(fresh["secret"])
    assert fresh["secret"] != answer["secret"]
    with state.database.write() as session:
        hook = session.scalars(sa.select(Webhook)).one()
        known = open_secrets(state.part(SecretBox), hook.secret_sealed)
        hook.secret_sealed = "gAAAAAB-sealed-under-another-key"
    assert (known.current, known.previous) == (fresh["secret"], answer["secret"])
    assert datetime.fromisoformat(fresh["previous_until"]) == known.previous_until
    replaced = owner.call("POST", f"{path}/secret")
    assert (replaced.status_code, replaced.json()["previous_until"]) == (200, None)


def test_log_pages_through_all_and_filters_by_state(owner, state):
    hook = owner.made()
    made = {owner.call("POST", f"/{hook}/test").json()["id"] for _ in range(5)}
    with state.database.write() as session:  # two of the same instant
        for row in session.scalars(sa.select(WebhookDelivery).limit(2)):
            row.created_at, row.state = datetime(2026, 11, 20, tzinfo=UTC), "given_up"
    seen, path = [], f"/{hook}/deliveries?limit=2"
    while path is not None:
        page = owner.call("GET", path).json()
        assert len(page["items"]) <= 2
        seen += [(row["created_at"], row["id"]) for row in page["items"]]
        path = page["next"].removeprefix(owner.root) if page["next"] else None
    assert {row_id for _, row_id in seen} == made
    assert len(seen) == 5
    assert seen == sorted(seen, reverse=True)
    assert len(owner.call("GET", f"/{hook}/deliveries?state=given_up").json()["items"]) == 2


def test_webhook_of_another_study_does_not_exist(client, admin, owner):
    hook = owner.made()
    delivery = owner.call("POST", f"/{hook}/test").json()["id"]
    client.post("/v1/studies", headers=admin, json={"code": "other", "name": "other", "marker": "plain:9x7:11"})
    other_hook = client.post(
        "/v1/studies/other/webhooks", headers=admin, json={"url": "https://hooks.example.org/", "events": ["*"]}
    ).json()["webhook"]["id"]
    calls = [
        ("GET", f"other/webhooks/{hook}", None),
        ("PATCH", f"other/webhooks/{hook}", {"is_enabled": False}),
        ("DELETE", f"other/webhooks/{hook}", None),
        ("POST", f"other/webhooks/{hook}/secret", None),
        ("POST", f"other/webhooks/{hook}/test", None),
        ("GET", f"other/webhooks/{hook}/deliveries", None),
        ("POST", f"other/webhooks/{hook}/deliveries/{delivery}/replay", None),
        ("POST", f"other/webhooks/{other_hook}/deliveries/{delivery}/replay", None),
        ("GET", f"none/webhooks/{hook}", None),
        ("GET", f"pilot/webhooks/{uuid.uuid4()}", None),
    ]
    for method, path, body in calls:
        answer = client.request(method, f"/v1/studies/{path}", headers=admin | {"If-Match": "*"}, json=body)
        assert answer.status_code == 404, path
    assert owner.call("GET", f"/{hook}").json()["disabled_at"] is None


def test_meal_is_announced_when_it_is_complete_when_it_fails_and_by_digest_only_when_it_is_deleted(owner, phone, state):
    path = f"/{owner.made()}"
    meal_id = str(uuid.uuid4())
    answer = phone.post({"left": photograph(1), "right": photograph(2)}, id=meal_id)
    assert answer.status_code == 202, answer.text
    assert phone.post({"left": photograph(1), "right": photograph(2)}, id=meal_id).status_code == 200  # again
    with state.database.write() as session:
        job = session.scalars(sa.select(Job)).one()
        jobs.fail_job(
            job, session.get_one(Meal, job.meal_id), Failure("marker_not_found", "SECRET WORDS"), datetime.now(UTC)
        )
    failed, received = owner.call("GET", f"{path}/deliveries").json()["items"]
    assert received["payload"]["data"] == {
        "study": "pilot",
        "participant": "P001",
        "meal_id": meal_id,
        "status": "queued",
        "version": received["payload"]["data"]["version"],
        "local_date": "2026-11-20",
        "failure_code": None,
    }
    assert (received["event"], failed["event"]) == ("meal.received", "meal.failed")
    assert failed["payload"]["data"]["failure_code"] == "marker_not_found"
    assert failed["payload"]["data"]["version"] == phone.get(f"/v1/meals/{meal_id}").json()["version"]
    assert failed["payload"]["data"]["version"] > received["payload"]["data"]["version"]
    assert "SECRET WORDS" not in json.dumps(failed)
    with state.database.read() as session:
        assert {row.meal_id for row in session.scalars(sa.select(WebhookDelivery))} == {job.meal_id}
        assert None not in {row.participant_id for row in session.scalars(sa.select(WebhookDelivery))}
    with state.database.write() as session:
        announce_meal_deletion(session, session.scalars(sa.select(Meal)).one())
    deleted = owner.call("GET", f"{path}/deliveries").json()["items"][0]
    assert deleted["event"] == "meal.deleted"
    assert meal_id not in json.dumps(deleted)
    assert deleted["payload"]["data"]["meal_sha256"] == hashlib.sha256(meal_id.encode()).hexdigest()


def test_meal_sent_in_parts_is_announced_with_its_last_part(owner, phone):
    path = f"/{owner.made()}"
    meal_id = str(uuid.uuid4())
    body = {"captured_at": "2026-11-20T12:30:00+08:00", "time_zone": "Asia/Shanghai"}
    phone.put(f"/v1/meals/{meal_id}", json=body)
    for number, slot in enumerate(("left", "right"), 1):
        assert owner.call("GET", f"{path}/deliveries").json()["items"] == []
        phone.put(
            f"/v1/meals/{meal_id}/images/{slot}", content=photograph(number), headers={"Content-Type": "image/jpeg"}
        )
    assert [row["event"] for row in owner.call("GET", f"{path}/deliveries").json()["items"]] == ["meal.received"]


def test_day_is_announced_when_it_is_closed_and_when_it_is_open_again(owner, phone):
    path = f"/{owner.made('https://hooks.example.org/a', 'day.closed', 'day.reopened')}"
    for body in ({"status": "closed"}, {"status": "closed", "ate_nothing": True}, {"status": "open"}):
        assert phone.put("/v1/me/days/2026-11-20", json=body, headers={"If-Match": "*"}).status_code == 200
    rows = owner.call("GET", f"{path}/deliveries").json()["items"][::-1]
    about = {"study": "pilot", "participant": "P001", "local_date": "2026-11-20"}
    assert [(row["event"], row["payload"]["data"]) for row in rows] == [
        ("day.closed", {**about, "ate_nothing": False}),
        ("day.closed", {**about, "ate_nothing": True}),
        ("day.reopened", {**about, "ate_nothing": False}),
    ]


def test_replay_beside_an_erasure_brings_nothing_back(owner, phone, state):
    path = f"/{owner.made()}"
    phone.post({"left": photograph(1), "right": photograph(2)})
    (row,) = owner.call("GET", f"{path}/deliveries").json()["items"]
    answers = []
    replays = threading.Thread(
        target=lambda: answers.append(owner.call("POST", f"{path}/deliveries/{row['id']}/replay"))
    )
    with state.database.write() as session:
        meal = lock_meal(session, session.scalars(sa.select(Meal.id)).one())
        session.execute(sa.delete(WebhookDelivery).where(WebhookDelivery.meal_id == meal.id))
        replays.start()
        wait_for_blocked_transaction(state.database)
        assert answers == []
    replays.join(PATIENCE_SECONDS)
    assert answers[0].status_code == 404
    assert owner.call("GET", f"{path}/deliveries").json()["items"] == []


def test_replay_of_a_notice_with_removed_data_is_refused(owner, phone, state):
    with receiver() as there:
        path = f"/{owner.made(there.url)}"
        with state.database.write() as session:
            announce_withdrawal(session, session.scalars(sa.select(Participant)).one(), "keep")
        deliver(state)
        (row,) = owner.call("GET", f"{path}/deliveries").json()["items"]
        assert "data" not in row["payload"]
        again = owner.call("POST", f"{path}/deliveries/{row['id']}/replay")
    assert (again.status_code, again.json()["code"]) == (409, "webhook_payload_removed")


def test_secret_stands_in_no_log(owner, state, capsys):
    with receiver(answer=500) as there:
        made = owner.make(there.url).json()
        owner.call("POST", f"/{made['webhook']['id']}/test")
        deliver(state)
        fresh = owner.call("POST", f"/{made['webhook']['id']}/secret").json()
    told = "".join(capsys.readouterr())
    for secret in (made["secret"], fresh["secret"]):
        assert secret.removeprefix("whsec_") not in told
