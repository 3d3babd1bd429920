"""Reminders: a phone subscribes, a worker reminds it at its times, and the push service's answers are heeded."""

import asyncio
import itertools
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from urllib.parse import urlsplit

import httpcore2
import httpx2
import pytest
import sqlalchemy as sa
import structlog

from app.core.settings import Settings
from app.extras.reminders import queries, send_reminders, subscriptions
from app.extras.reminders.send_reminders import LATE, LOOK_AGAIN, SendReminders
from app.extras.reminders.web_push import VapidKey, text_of
from app.meals.stored.models import Meal
from app.people.access.secret_box import SecretBox
from app.people.models import PushSubscription
from app.webhooks.webhook_post import WebhookPost
from tests.support.photographs import pair
from tests.support.push_services import Browser, claims_of
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction, wait_until

CONTACT = "mailto:study@example.org"
PATH = "/v1/me/reminders"
ENDPOINT = "https://push.example.org/send/abc"
MORNING = datetime(2026, 11, 27, 8, tzinfo=UTC)


class PushService:
    """Takes messages, as a pool of connections; answers with `status` once `may_answer` is set."""

    def __init__(self):
        self.requests, self.answers, self.status, self.may_answer = [], 0, 201, threading.Event()
        self.may_answer.set()

    async def handle_async_request(self, request):
        content = b"".join([part async for part in request.stream])
        self.requests.append(httpx2.Request("POST", ENDPOINT, headers=request.headers, content=content))
        await asyncio.to_thread(self.may_answer.wait, PATIENCE_SECONDS)
        self.answers += 1
        return httpcore2.Response(self.status)

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        pass


@pytest.fixture
def settings(settings) -> Settings:
    return settings.model_copy(update={"push_contact": CONTACT})


@pytest.fixture
def browser():
    return Browser()


@pytest.fixture
def service():
    return PushService()


@pytest.fixture
def clock():
    return [MORNING]


@pytest.fixture
def make_sender(state, service, clock):
    """Return a worker's chore that sends to the push service at the clock's time."""
    post = WebhookPost(allow_loopback=False, resolve=lambda *_: ["93.184.215.14"], pool=service)
    return lambda: SendReminders(state.database, state.part(SecretBox), post, CONTACT, now=lambda: clock[0])


@pytest.fixture
def remind(make_sender, clock):
    """Run the worker's chore at the clock's time, until all is sent."""
    sender = make_sender()

    def remind(at=None):
        clock[0] = at or clock[0]
        count = sender.run()
        sender.wait_until_idle(PATIENCE_SECONDS)
        return count

    return remind


def wanted(browser, number=0, **changes):
    """Settings of a phone. number: of the endpoint, where several phones have a browser with the same keys."""
    keys = {"p256dh": text_of(browser.receiver.public_key), "auth": text_of(browser.receiver.auth)}
    return {
        "subscription": {"endpoint": f"{ENDPOINT}{number or ''}", "keys": keys},
        "times": ["12:30", "18:00"],
        "time_zone": "Europe/Berlin",
    } | changes


def scheduled_from(state, now, times=("11:30", "17:00")):
    """As if the phone had subscribed at `now`: its next reminder is the first of these UTC times after it."""
    instants = [datetime.fromisoformat(f"{now:%Y-%m-%d}T{at}:00+00:00") for at in times]
    with state.database.write() as session:
        session.query(PushSubscription).one().next_at = min(instant for instant in instants if instant > now)


def make_all_due(state, at):
    with state.database.write() as session:
        session.execute(sa.update(PushSubscription).values(next_at=at))


def subscription_of(state):
    with state.database.read() as session:
        return session.query(PushSubscription).one_or_none()


def subscriptions_of(state):
    with state.database.read() as session:
        return session.query(PushSubscription).all()


def set_times(client, admin, *times):
    """Set the study's times. Returns them."""
    version = client.get("/v1/studies/pilot", headers=admin).json()["version"]
    headers = admin | {"If-Match": f'"{version}"'}
    return client.patch("/v1/studies/pilot", headers=headers, json={"reminder_times": times}).json()["reminder_times"]


def test_phone_subscribes_changes_and_leaves(phone, browser, state):
    before = phone.get(PATH).json()
    assert (before["available"], before["subscribed"]) == (True, False)
    assert before["public_key"] == VapidKey(state.part(SecretBox)).public_key
    after = phone.put(PATH, json=wanted(browser)).json()
    assert (after["subscribed"], after["times"], after["quiet_from"]) == (True, ["12:30", "18:00"], "22:00")
    assert phone.put(PATH, json=wanted(browser, times=None)).json()["times"] is None
    assert phone.client.delete(PATH, headers=phone.headers).status_code == 204
    assert phone.get(PATH).json()["subscribed"] is False
    assert phone.client.delete(PATH, headers=phone.headers).status_code == 204


IMPOSSIBLE = [
    ({"time_zone": "Mars/Olympus"}, "time_zone_unknown"),
    ({"times": ["25:00"]}, "invalid_input"),
    ({"times": ["12:00"] * 9}, "invalid_input"),
    ({"quiet_from": "7"}, "invalid_input"),
    ({"subscription": {"endpoint": ENDPOINT, "keys": {"p256dh": "AAAA", "auth": "AAAA"}}}, "invalid_input"),
    ({"subscription": {"endpoint": ENDPOINT, "keys": {"p256dh": "ä", "auth": "ä"}}}, "invalid_input"),
]


def test_impossible_settings_and_an_endpoint_that_no_push_service_has_are_refused(phone, browser):
    for changes, code in IMPOSSIBLE:
        refused = phone.put(PATH, json=wanted(browser, **changes))
        assert (refused.status_code, refused.json()["code"]) == (422, code), changes
    for endpoint in ("http://push.example.org/a", "https://localhost/"):
        body = wanted(browser)
        body["subscription"]["endpoint"] = endpoint
        refused = phone.put(PATH, json=body)
        assert (refused.status_code, refused.json()["code"]) == (422, "webhook_address_refused"), endpoint


def test_endpoint_inside_the_servers_network_is_never_called(phone, browser, state, monkeypatch):
    phone.put(PATH, json=wanted(browser))
    connections = []
    monkeypatch.setattr(httpcore2.AnyIOBackend, "connect_tcp", lambda *place: connections.append(place))
    post = WebhookPost(allow_loopback=False, resolve=lambda *_: ["169.254.169.254"])
    now = datetime.now(UTC) + timedelta(days=1)
    with state.database.write() as session:
        session.query(PushSubscription).one().next_at = now
    sender = SendReminders(state.database, state.part(SecretBox), post, CONTACT, now=lambda: now)
    assert sender.run() == 1
    sender.wait_until_idle(PATIENCE_SECONDS)
    assert connections == []


def test_phone_is_reminded_at_each_of_its_times_once_until_it_signs_out_and_only_it_can_read_that(
    phone, browser, state, service, remind, client
):
    phone.put(PATH, json=wanted(browser))
    scheduled_from(state, MORNING)
    assert remind() == 0
    assert remind(MORNING.replace(hour=11, minute=30)) == 1  # 12:30 in Berlin
    assert remind() == 0
    assert remind(MORNING.replace(hour=17, minute=1)) == 1
    first = service.requests[0]
    assert json.loads(browser.read(first.content)) == {"kind": "meal"}
    claims = claims_of(first.headers["Authorization"])
    assert (claims["aud"], claims["sub"]) == ("https://push.example.org", CONTACT)
    assert (first.headers["Content-Encoding"], first.headers["Host"]) == ("aes128gcm", urlsplit(ENDPOINT).netloc)
    assert subscription_of(state).next_at == MORNING.replace(day=28, hour=11, minute=30)
    client.delete("/v1/me/device", headers=phone.headers)
    assert subscription_of(state) is None
    assert remind(MORNING.replace(day=28, hour=11, minute=30)) == 0


@pytest.mark.parametrize(("times", "count"), [(["12:30", "18:00"], 1), (["18:00"], 0)])
def test_reminder_that_is_due_stays_so_when_the_phone_sends_another_time_zone(
    phone, browser, state, remind, times, count
):
    """But not when it no longer wants the time."""
    phone.put(PATH, json=wanted(browser))
    with state.database.write() as session:
        session.query(PushSubscription).one().next_at = datetime.now(UTC) - timedelta(seconds=10)
    phone.put(PATH, json=wanted(browser, times=times, time_zone="Asia/Shanghai"))
    assert remind(datetime.now(UTC)) == count
    assert subscription_of(state).next_at > datetime.now(UTC)


def test_study_s_times_hold_without_own_ones_from_when_it_has_some_but_not_in_quiet_hours(
    enrol, client, admin, browser, state, remind
):
    phone = enrol(reminder_times=["06:00", "12:30"])
    assert phone.get(PATH).json()["study_times"] == ["06:00", "12:30"]
    phone.put(PATH, json=wanted(browser, times=None))
    scheduled_from(state, MORNING, ["11:30"])
    assert remind(MORNING.replace(hour=11, minute=30)) == 1
    assert subscription_of(state).next_at == MORNING.replace(day=28, hour=11, minute=30)  # 06:00 is quiet
    assert set_times(client, admin) == []
    noon = MORNING.replace(day=28, hour=11, minute=30)
    assert remind(noon) == 0  # although it was planned
    assert subscription_of(state).next_at is None
    set_times(client, admin, "12:30")
    assert remind(MORNING.replace(day=28)) == 0
    assert subscription_of(state).next_at == noon


@pytest.mark.both_stores
def test_earlier_time_of_the_study_holds_at_once_and_own_times_stay(enrol, client, admin, browser, state, remind):
    follower, other = (enrol(participant, reminder_times=["18:00"]) for participant in ("P01", "P02"))
    follower.put(PATH, json=wanted(browser, 1, times=None))
    other.put(PATH, json=wanted(browser, 2, times=["18:00"]))
    planned = [row.next_at for row in subscriptions_of(state)]
    set_times(client, admin, "12:30")
    remind(MORNING)
    followed, own = sorted(row.next_at for row in subscriptions_of(state))
    assert followed == MORNING.replace(hour=11, minute=30)
    assert own in planned


def test_phones_whose_quiet_hours_cover_all_times_hold_no_other_up(
    enrol, client, admin, browser, state, remind, monkeypatch
):
    monkeypatch.setattr(send_reminders, "BATCH", 1)
    for number in range(3):
        quiet = {"quiet_from": "12:00", "quiet_until": "13:00"} if number < 2 else {}
        enrol(f"P{number}").put(PATH, json=wanted(browser, number, times=None, **quiet))
    set_times(client, admin, "12:30")
    for _ in range(3):
        assert remind(MORNING) == 0
    assert min(row.next_at for row in subscriptions_of(state)) == MORNING.replace(hour=11, minute=30)
    assert [row.next_at.year > MORNING.year + 100 for row in subscriptions_of(state)].count(True) == 2


def test_one_run_reminds_all_that_are_due_however_many_and_leaves_out_and_counts_those_that_are_late(
    enrol, browser, state, service, remind, monkeypatch
):
    monkeypatch.setattr(send_reminders, "BATCH", 2)
    for number in range(5):
        enrol(f"P{number}").put(PATH, json=wanted(browser, number))
    make_all_due(state, MORNING)
    remind(MORNING)
    assert len(service.requests) == 5
    remind(MORNING)
    assert len(service.requests) == 5
    late = LATE + timedelta(minutes=1)
    with state.database.write() as session:
        for number, row in enumerate(session.query(PushSubscription)):
            row.next_at = MORNING if number == 4 else MORNING - late
    with structlog.testing.capture_logs() as logs:
        remind(MORNING)
    assert len(service.requests) == 6
    assert sum(line["count"] for line in logs if line["event"] == "reminders_too_late") == 4
    assert {row.next_at for row in subscriptions_of(state)} == {MORNING.replace(hour=11, minute=30)}


@pytest.mark.both_stores
def test_messages_under_way_are_sent_though_the_next_rows_cannot_be_read(
    enrol, browser, state, service, remind, monkeypatch
):
    monkeypatch.setattr(send_reminders, "BATCH", 2)
    for number in range(3):
        enrol(f"P{number}").put(PATH, json=wanted(browser, number))
    make_all_due(state, MORNING)
    due, calls = queries.due, itertools.count(1)

    def fail_at_the_second_call(session, now, limit):
        if next(calls) == 2:
            threading.Timer(0.2, service.may_answer.set).start()
            raise sa.exc.OperationalError("", {}, Exception("the database was restarted"))
        return due(session, now, limit)

    monkeypatch.setattr(queries, "due", fail_at_the_second_call)
    service.may_answer.clear()
    with structlog.testing.capture_logs() as logs:
        remind(MORNING)
    assert service.answers == 2
    assert [line["log_level"] for line in logs if line["event"] == "reminders_broken_off"] == ["error"]
    remind(MORNING)
    assert service.answers == 3


def test_worker_that_ends_leaves_what_it_has_not_begun_to_another(
    enrol, browser, state, service, make_sender, clock, monkeypatch
):
    monkeypatch.setattr(send_reminders, "AT_ONCE", 2)
    noon = clock[0] = MORNING.replace(hour=12)
    phones = [enrol(f"P{number}", expects_after_pair=True, after_window_minutes=30) for number in range(5)]
    for number, phone in enumerate(phones):
        phone.put(PATH, json=wanted(browser, number))
    phones[0].post(pair(), captured_at="2026-11-27T11:45:00Z", time_zone="Europe/London")
    make_all_due(state, noon)
    service.may_answer.clear()
    ending = make_sender()
    ending.run()
    wait_until(lambda: len(service.requests) == 2, "two messages under way")
    threading.Timer(0.1, service.may_answer.set).start()
    ending.stop()
    assert service.answers == len(service.requests) == 2
    assert ending.run() == 0
    assert [row.next_at for row in subscriptions_of(state)].count(noon) == 3
    other = make_sender()
    assert other.run() == 4
    other.wait_until_idle(PATIENCE_SECONDS)
    kinds = [json.loads(browser.read(request.content))["kind"] for request in service.requests]
    assert (kinds.count("meal"), kinds.count("after_meal")) == (5, 1)
    assert make_sender().run() == 0


def test_what_a_phone_changed_meanwhile_is_not_moved_back(enrol, browser, state, service, make_sender, monkeypatch):
    monkeypatch.setattr(send_reminders, "AT_ONCE", 1)
    phones = [enrol(f"P{number}") for number in range(2)]
    for number, phone in enumerate(phones):
        phone.put(PATH, json=wanted(browser, number))
    make_all_due(state, MORNING)
    service.may_answer.clear()
    ending = make_sender()
    ending.run()
    wait_until(lambda: len(service.requests) == 1, "a message under way")
    for number, phone in enumerate(phones):
        phone.put(PATH, json=wanted(browser, number, times=["20:15"]))
    expected = [row.next_at for row in subscriptions_of(state)]
    threading.Timer(0.1, service.may_answer.set).start()
    ending.stop()
    assert [row.next_at for row in subscriptions_of(state)] == expected
    assert MORNING not in expected


def test_unknown_time_zone_stops_nobody_elses_reminders(enrol, browser, state, remind):
    at = MORNING + timedelta(minutes=31)  # within the last half hour of both meals' windows
    for number in range(2):
        phone = enrol(f"P{number}", expects_after_pair=True, after_window_minutes=120)
        phone.put(PATH, json=wanted(browser, number))
        phone.post(pair(), captured_at="2026-11-27T07:00:00Z", time_zone="Europe/London")
    with state.database.write() as session:
        lost, _ = rows = session.query(PushSubscription).all()
        lost.time_zone = "Mars/Olympus"
        for row in rows:
            row.next_at = at
        lost_id = lost.device_id
    assert remind(at) == 2  # of the meal and of what is left, the other phone alone
    (row,) = [row for row in subscriptions_of(state) if row.device_id == lost_id]
    assert row.next_at == at + LOOK_AGAIN


def test_browser_that_has_unsubscribed_is_forgotten(phone, browser, state, service, remind):
    for status, stays in ((201, True), (429, True), (500, True), (404, False), (410, False)):
        phone.put(PATH, json=wanted(browser))
        scheduled_from(state, MORNING)
        service.status = status
        remind(MORNING.replace(hour=11, minute=30))
        assert (subscription_of(state) is not None) is stays, status
    assert len(service.requests) == 5


def test_phone_is_reminded_once_of_what_is_left_before_the_window_ends(enrol, browser, state, service, remind):
    phone = enrol(expects_after_pair=True, after_window_minutes=120)
    phone.post(pair(), captured_at="2026-11-27T12:00:00Z", time_zone="Europe/London")
    phone.put(PATH, json=wanted(browser, times=[]))
    noon = MORNING.replace(hour=12)
    assert remind(noon + timedelta(minutes=60)) == 0
    assert remind(noon + timedelta(minutes=95)) == 1
    assert remind(noon + timedelta(minutes=100)) == 0
    assert json.loads(browser.read(service.requests[0].content)) == {"kind": "after_meal"}


@pytest.mark.parametrize("why", ["pair", "quiet", "unwanted"])
def test_nothing_is_said_of_what_is_left_where_it_is_here_or_not_wanted(enrol, browser, state, remind, why):
    phone = enrol(expects_after_pair=True, after_window_minutes=120)
    phone.post(pair(), captured_at="2026-11-27T12:00:00Z", time_zone="Europe/London")
    quiet = {"quiet_from": "13:00", "quiet_until": "20:00"} if why == "quiet" else {}
    phone.put(PATH, json=wanted(browser, times=[], after_meal=why != "unwanted", **quiet))
    if why == "pair":
        with state.database.write() as session:
            session.query(Meal).one().after_status = "queued"
    assert remind(MORNING.replace(hour=13, minute=40)) == 0


def test_browser_that_joins_for_somebody_else_is_reminded_of_the_new_person_alone(enrol, browser, state, remind):
    """The former person's sign-out may not have arrived."""
    former, new, elsewhere = (enrol(f"P{number}") for number in range(3))
    former.put(PATH, json=wanted(browser))
    elsewhere.put(PATH, json=wanted(Browser()))  # the same endpoint without that browser's secret
    new.put(PATH, json=wanted(browser))
    assert len(subscriptions_of(state)) == 2
    assert not former.get(PATH).json()["subscribed"]
    assert elsewhere.get(PATH).json()["subscribed"]


@pytest.mark.both_stores
def test_first_subscriptions_of_a_phone_at_once_make_one(phone, browser, state, monkeypatch):
    next_at, first = subscriptions.next_at, threading.Lock()

    def next_at_when_both_are_there(*arguments):
        if first.acquire(blocking=False):
            wait_for_blocked_transaction(state.database)  # the second one waits for the first one's commit
        return next_at(*arguments)

    monkeypatch.setattr(subscriptions, "next_at", next_at_when_both_are_there)
    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(lambda _: phone.put(PATH, json=wanted(browser)).status_code, range(2)))
    assert answers == [200, 200]
    assert len(subscriptions_of(state)) == 1


class TestOff:
    @pytest.fixture
    def settings(self, settings):
        return settings.model_copy(update={"push_contact": None})

    def test_without_a_contact_no_phone_can_subscribe(self, phone, browser):
        answer = phone.get(PATH).json()
        assert (answer["available"], answer["public_key"]) == (False, None)
        refused = phone.put(PATH, json=wanted(browser))
        assert (refused.status_code, refused.json()["code"]) == (409, "reminders_off")


def test_staff_remind_participants_at_once_but_not_in_their_quiet_hours(
    phone, browser, state, service, remind, client, admin, enrol
):
    night = (datetime.now(UTC) - timedelta(hours=1), datetime.now(UTC) + timedelta(hours=1))
    quiet = {"quiet_from": f"{night[0]:%H:%M}", "quiet_until": f"{night[1]:%H:%M}", "time_zone": "UTC"}
    never_quiet = {"quiet_from": "22:00", "quiet_until": "22:00", "time_zone": "UTC"}
    phone.put(PATH, json=wanted(browser, times=None, **never_quiet))
    enrol("P002").put(PATH, json=wanted(Browser(), 2, times=None, **quiet))
    enrol("P003")
    target = "/v1/studies/pilot/reminders"
    told = client.post(target, headers=admin, json={"participants": ["P003", "P002", "P001"]})
    assert told.json() == {"reminded": ["P001"], "unreached": ["P002", "P003"]}, told.text
    assert remind(datetime.now(UTC)) == 1
    assert json.loads(browser.read(service.requests[0].content)) == {"kind": "meal"}
    assert remind(datetime.now(UTC) + timedelta(days=1)) == 0, "without times only once"
    log = client.get("/v1/studies/pilot/audit", headers=admin, params={"action": "participants.remind"}).json()
    assert [event["details"] for event in log["items"]] == [{"count": 1}]
    assert client.post(target, headers=phone.headers, json={"participants": ["P001"]}).status_code == 403
